"""Files that go or change between being listed and being read, or while they are read."""

import builtins
import io
import os

import numpy as np
import pytest
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.io import read_image, read_jpeg, read_raw, write_png
from jaxisp.io.digests import digest_of
from jaxisp.io.files import load_npy, read_json, read_toml
from jaxisp.io.images import read_as_stored
from jaxisp.io.libraw import embedded_jpeg
from jaxisp.testing import smooth_image
from tests.io.samples import dng


def other(path):
    """Another sound file takes the name."""
    path.with_name("other").rename(path)


CHANGES = {
    "goes": lambda path: path.unlink(),
    "is cut": lambda path: os.truncate(path, path.stat().st_size // 2),
    "is emptied": lambda path: os.truncate(path, 0),
    "is another": other,
}
READERS = {
    "a.png": (read_image, read_as_stored, digest_of),
    "a.jpg": (read_image, read_as_stored, read_jpeg),
    "a.tif": (read_image, read_as_stored),
    "a.npy": (read_image, read_as_stored, load_npy),
    "a.dng": (read_raw, embedded_jpeg),
    "a.toml": (read_toml,),
    "a.json": (read_json,),
}


def make(folder):
    """A file of each kind, and another of the kind and of another size, as `other`."""
    for k, shape in enumerate(((24, 30, 3), (22, 26, 3))):
        place = folder / str(k)
        place.mkdir()
        picture = np.uint8(255 * smooth_image(shape, k))
        write_png(place / "a.png", picture)
        Image.fromarray(picture).save(place / "a.jpg")
        Image.fromarray(picture).save(place / "a.tif")
        np.save(place / "a.npy", picture)
        dng(place / "a.dng", **({"black": (60,)} if k else {}))
        (place / "a.toml").write_text(f"a = {10**k}\n")
        (place / "a.json").write_text(f'{{"a": {10**k}}}\n')


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    make(folder)
    return folder


@pytest.mark.parametrize("how", CHANGES)
@pytest.mark.parametrize("name", READERS)
def test_a_reader_gives_one_error_or_one_of_both_files(kinds, tmp_path, monkeypatch, name, how):
    path, left = tmp_path / name, [0]

    def wrapped(call):
        def disturbed(file, *arguments, **options):
            if isinstance(file, (str, os.PathLike)) and os.fspath(file) == str(path):
                left[0] -= 1
                if left[0] == 0:
                    CHANGES[how](path)
            return call(file, *arguments, **options)

        return disturbed

    for module, function in ((builtins, "open"), (io, "open"), (os, "open"), (os, "stat")):
        monkeypatch.setattr(module, function, wrapped(getattr(module, function)))
    for reader in READERS[name]:
        step = 0
        while True:
            step += 1
            for k, target in enumerate((path, tmp_path / "other")):
                target.write_bytes((kinds / str(k) / name).read_bytes())
            left[0] = step
            try:
                reader(path)
            except InputError as error:
                assert str(path) in str(error) and "\n" not in str(error)
            if left[0] > 0:  # it was read before its turn came
                break
        assert step > 2


def test_a_file_that_changes_while_it_is_read_is_not_read(tmp_path, monkeypatch):
    path, whole = dng(tmp_path / "a.dng"), dng(tmp_path / "b.dng", black=(60,)).read_bytes()
    from jaxisp.io import raw

    checked = raw._check_magic
    monkeypatch.setattr(raw, "_check_magic", lambda path: (checked(path), path.write_bytes(whole)))
    with pytest.raises(InputError, match=r"a\.dng: changed while it was read"):
        read_raw(path)


def test_an_archive_is_no_array(tmp_path):
    with open(tmp_path / "a.npy", "wb") as file:
        np.savez(file, np.zeros((4, 4, 3), np.uint8))
    for reader in (load_npy, read_image):
        with pytest.raises(InputError, match=r"a\.npy: is a damaged .* \(holds no single array\)"):
            reader(tmp_path / "a.npy")
