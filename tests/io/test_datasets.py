"""Data sets: what belongs together, settings by stem, lone halves, loading."""

import numpy as np
import pytest

from jaxisp.errors import InputError
from jaxisp.io.datasets import open_dataset
from jaxisp.io.images import write_png
from jaxisp.io.jpeg import encode_jpeg, write_jpeg
from jaxisp.io.orientation import orient
from jaxisp.testing import smooth_image
from tests.io.samples import dng, mosaic

PICTURE = smooth_image((52, 70, 3))


def refused(folder, words: str, **options) -> None:
    with pytest.raises(InputError) as caught:
        open_dataset(folder, **options)
    text = str(caught.value)
    assert str(folder) in text and "\n" not in text and words in text, text


def names(dataset) -> list[str]:
    return [pair.name for pair in dataset.pairs]


def test_raw_and_jpeg(tmp_path):
    dng(tmp_path / "b.dng", iso=640)
    write_jpeg(tmp_path / "b.JPG", PICTURE, quality=80)
    dng(tmp_path / "a.dng")
    write_png(tmp_path / "a.png", PICTURE)
    (tmp_path / "notes.txt").write_text("x")
    dataset = open_dataset(tmp_path)
    assert dataset.kind == "raw+jpeg" and names(dataset) == ["a", "b"] and dataset.problems == ()
    first, second = (pair.load() for pair in dataset.pairs)
    assert first.jpeg is None and second.jpeg.quality == 80 and second.iso == 640
    np.testing.assert_allclose(first.picture, PICTURE, atol=0.5 / 255 + 1e-6)
    assert first.raw.mosaic.shape == (52, 70) and first.clean is None and not first.embedded
    assert first.picture.dtype == np.float32


def test_raw_npy_with_settings(tmp_path):
    np.save(tmp_path / "one.raw.npy", np.full((1, 1, 6, 8), 0.5, np.float32))
    np.save(tmp_path / "two.raw.npy", np.full((6, 8), 0.5, np.float32))
    for name in ("one", "two"):
        write_png(tmp_path / f"{name}.png", PICTURE[:6, :8])
    (tmp_path / "dataset.toml").write_text(
        'camera = "Phone"\niso = 100\n[raw]\ncfa = "GRBG"\nwhite = 1.0\nwhite_balanced = true\n'
        "[jpeg]\ncropped = true\n[two]\niso = 800\n[two.raw]\nblack = 0.1\n"
    )
    one, two = open_dataset(tmp_path).pairs
    assert (one.settings.camera, one.settings.iso, one.settings.cropped) == ("Phone", 100, True)
    assert (two.settings.camera, two.settings.iso, two.settings.raw.cfa) == ("Phone", 800, "GRBG")
    assert one.load().raw.white_balanced and one.load().raw.cfa == "GRBG" and one.load().iso == 100
    np.testing.assert_allclose(two.load().raw.mosaic, 0.4 / 0.9, rtol=1e-6)


def test_clean_and_noisy_with_frames(tmp_path):
    write_png(tmp_path / "s.clean.png", PICTURE)
    for name in ("s.f00.jpg", "s.f01.jpg", "s.jpg", "t.jpg"):
        write_jpeg(tmp_path / name, PICTURE)
    np.save(tmp_path / "t.clean.npy", PICTURE.astype(np.float32) ** 2)
    write_png(tmp_path / "u.clean.png", PICTURE)
    np.save(tmp_path / "u.noisy.npy", PICTURE)
    (tmp_path / "dataset.toml").write_text(
        '[t]\nclean_encoding = "linear"\n["s.f01"]\niso = 50\n[s]\niso = 25\n'
    )
    dataset = open_dataset(tmp_path)
    assert dataset.kind == "clean+noisy" and names(dataset) == ["s", "s.f00", "s.f01", "t", "u"]
    assert [(p.scene, p.frame) for p in dataset.pairs[:3]] == [("s", None), ("s", 0), ("s", 1)]
    assert [p.settings.iso for p in dataset.pairs] == [25, 25, 50, None, None]
    assert [p.settings.clean_encoding for p in dataset.pairs] == ["srgb"] * 3 + ["linear", "srgb"]
    loaded = [pair.load() for pair in dataset.pairs]
    np.testing.assert_array_equal(loaded[0].clean, loaded[2].clean)
    np.testing.assert_allclose(loaded[3].clean, PICTURE**2, atol=1e-6)
    np.testing.assert_allclose(loaded[4].picture, PICTURE, atol=1e-6)
    assert loaded[0].jpeg.subsampling == "4:2:0" and loaded[4].jpeg is None and loaded[0].raw is None


def test_frames_of_raw_files(tmp_path):
    for name in ("s.f00", "s.f01"):
        dng(tmp_path / f"{name}.dng")
        write_jpeg(tmp_path / f"{name}.jpg", PICTURE)
    assert [(p.name, p.scene, p.frame) for p in open_dataset(tmp_path).pairs] == [
        ("s.f00", "s", 0),
        ("s.f01", "s", 1),
    ]


def test_embedded_jpeg_stands_in(tmp_path):
    data = encode_jpeg(np.rint(PICTURE * 255).astype(np.uint8), 91, "4:2:2")
    dng(tmp_path / "a.dng", preview=data)
    dng(tmp_path / "b.dng")
    dataset = open_dataset(tmp_path)
    assert names(dataset) == ["a"]
    assert dataset.problems == ((tmp_path / "b.dng", "has no JPEG beside it, and embeds no full-size one"),)
    loaded = dataset.pairs[0].load()
    assert loaded.embedded and loaded.jpeg.subsampling == "4:2:2" and loaded.jpeg.quality == 91
    write_jpeg(tmp_path / "a.jpg", PICTURE, quality=50)
    assert open_dataset(tmp_path).pairs[0].load().jpeg.quality == 50


@pytest.mark.parametrize(
    ("raw_orientation", "how"),
    [
        (o, how)
        for o in (1, 3, 6, 8)
        for how in ("same tag", "turned", "tag lost")
        if (o, how) != (3, "tag lost")
    ],
)
def test_the_picture_is_turned_as_the_raw_is_stored(tmp_path, raw_orientation, how):
    """The JPEG carries the RAW's tag, or has its pixels upright, or lost its tag.

    A half turn whose tag is lost does not show in the shapes, so it is not found.
    """
    dng(tmp_path / "a.dng", mosaic(52, 70), orientation=raw_orientation)
    stored = orient(PICTURE, raw_orientation) if how == "turned" else PICTURE
    tag = raw_orientation if how == "same tag" else 1
    write_jpeg(tmp_path / "a.jpg", stored, quality=100, subsampling="4:4:4", orientation=tag)
    loaded = open_dataset(tmp_path).pairs[0].load()
    np.testing.assert_allclose(loaded.picture, PICTURE, atol=0.02)
    assert loaded.jpeg.pixels.shape == stored.shape


def test_lone_halves_are_listed(tmp_path):
    write_png(tmp_path / "a.clean.png", PICTURE)
    write_jpeg(tmp_path / "a.jpg", PICTURE)
    write_jpeg(tmp_path / "lone.jpg", PICTURE)
    write_png(tmp_path / "other.clean.png", PICTURE)
    problems = dict(open_dataset(tmp_path).problems)
    assert problems == {
        tmp_path / "lone.jpg": "has no clean file beside it",
        tmp_path / "other.clean.png": "has no noisy file beside it",
    }


def test_lone_and_damaged_raw_files(tmp_path):
    dng(tmp_path / "a.dng")
    write_jpeg(tmp_path / "a.jpg", PICTURE)
    write_jpeg(tmp_path / "b.jpg", PICTURE)
    (tmp_path / "c.dng").write_bytes(b"II*\0 not a DNG")
    problems = dict(open_dataset(tmp_path).problems)
    assert problems[tmp_path / "b.jpg"] == "has no RAW file beside it"
    assert problems[tmp_path / "c.dng"].startswith("LibRaw cannot read it")
    (tmp_path / "a.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:3000])
    with pytest.raises(InputError, match="truncated"):
        open_dataset(tmp_path).pairs[0].load()


def test_refused_folders(tmp_path):
    refused(tmp_path / "none", "no such folder")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "is empty")
    lone = tmp_path / "lone"
    lone.mkdir()
    dng(lone / "a.dng")
    refused(lone, "holds no pair of RAW and JPEG")
    refused(lone, "a.dng: has no JPEG")
    refused(lone, "holds no clean+noisy pair", kind="clean+noisy")
    refused(lone / "a.dng", "is a file")
    write_jpeg(lone / "a.jpg", PICTURE)
    assert len(open_dataset(lone).pairs) == 1
    write_png(lone / "a.clean.png", PICTURE)
    refused(lone, "1 raw+jpeg pairs and 1 clean+noisy pairs")
    assert open_dataset(lone, kind="clean+noisy").pairs[0].raw is None
    refused(lone, "no kind of data set", kind="both")
    write_jpeg(lone / "a.jpeg", PICTURE)
    refused(lone, "both are the jpeg file")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera = ", "line 1"),
        ("camera = 3", "camera = 3, expected text"),
        ("iso = -1", "iso = -1"),
        ("iso = nan", "iso = nan"),
        ("iso = true", "iso = True"),
        ('clean_encoding = "gamma"', "gamma"),
        ("colour = 3", "unknown key 'colour'"),
        ("[nobody]\niso = 3", "[nobody] names no files"),
        ("[a]\nisso = 3", "[a] unknown key 'isso'"),
        ('[raw]\ncfa = "XXXX"', "XXXX"),
        ("[jpeg]\ncropped = 1", "cropped"),
        ("[jpeg]\ncroped = true", "croped"),
    ],
)
def test_bad_settings(tmp_path, text, words):
    dng(tmp_path / "a.dng")
    write_jpeg(tmp_path / "a.jpg", PICTURE)
    (tmp_path / "dataset.toml").write_text(text)
    refused(tmp_path, words)
    with pytest.raises(InputError, match=r"dataset\.toml"):
        open_dataset(tmp_path)


def test_unquoted_frame_tables(tmp_path):
    write_png(tmp_path / "s.clean.png", PICTURE)
    write_jpeg(tmp_path / "s.f00.jpg", PICTURE)
    write_jpeg(tmp_path / "s.f01.jpg", PICTURE)
    (tmp_path / "dataset.toml").write_text("[s]\niso = 10\n[s.f01]\niso = 20\n")
    assert [p.settings.iso for p in open_dataset(tmp_path).pairs] == [10, 20]
