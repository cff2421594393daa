"""A recipe narrowed to noisy pictures whose camera is known."""

import json
import shutil

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import jaxisp
from jaxisp.adapt import _crop, _Header, _laws, _narrowed, _nearest, _ridge, _scaled, _stated, _values, adapt
from jaxisp.cli import main
from jaxisp.color import LUMA_601
from jaxisp.data import downsample_linear
from jaxisp.data.procedural import KINDS, drawn
from jaxisp.errors import InputError
from jaxisp.io import read_image, write_png
from jaxisp.io.jpeg import write_jpeg
from jaxisp.models import make_model, save_network
from jaxisp.pipeline import Chain, stage
from jaxisp.priors import Bernoulli, Choice, LogUniform, Normal, PowerUniform, Uniform
from jaxisp.recipe import Recipe
from jaxisp.stages.blur import MotionBlur
from jaxisp.stages.jpeg import Jpeg
from jaxisp.stages.noise import GaussianNoise
from jaxisp.train.finetune import clean_from

CAMERAS = Recipe(
    Chain((stage("gaussian_noise"), stage("clip"), stage("jpeg", subsampling="4:4:4")), "cameras"),
    {
        "gaussian_noise": GaussianNoise(std=LogUniform(0.002, 0.2)),
        "jpeg": Jpeg(quality=Uniform(30.0, 98.0)),
    },
)


def scenes(folder, count=6, side=200):
    """Smooth and textured pictures; the noisy ones of one camera, the clean ones of other scenes."""
    rng = np.random.default_rng(5)
    for i in range(count):
        soft = gaussian_filter(rng.random((side, side, 3)), (12, 12, 0))
        fine = gaussian_filter(rng.random((side, side, 1)), (1.0, 1.0, 0)) - 0.5
        picture = 0.5 + 4 * (soft - 0.5) + np.where(np.arange(side)[:, None, None] < side // 2, fine, 0)
        write_png(folder / f"{i}.png", np.clip(picture, 0, 1).astype(np.float32))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("adapt")
    for name in ("clean", "before", "noisy"):
        (root / name).mkdir()
    scenes(root / "clean", 8)
    scenes(root / "before", 4)
    camera = CAMERAS.override(gaussian_noise={"std": 0.03}, jpeg={"quality": 85.0})
    images = np.stack([read_image(path) for path in sorted((root / "before").iterdir())])
    for i, noisy in enumerate(np.asarray(camera.degrade(jax.random.key(4), images[:, ::-1])[0])):
        write_png(root / "noisy" / f"{i}.png", np.clip(noisy, 0, 1))
    return root


def test_the_camera_lies_in_the_narrowed_ranges(folders):
    found = adapt(folders / "noisy", CAMERAS, clean=folders / "clean", downsample=1, draws=256)
    noise, quality = (one.after for one in found.priors)
    assert noise.low < 0.03 < noise.high and quality.low < 85 < quality.high
    assert np.log(noise.high / noise.low) < 0.5 * np.log(100)
    assert quality.high - quality.low < 0.3 * 68
    assert found.priors[0].told > 0.9 and found.strange < 0.3 and found.crops > 20
    assert found.recipe.prior["jpeg"].quality == quality
    luma = 0.03 * 255 * np.sqrt((np.asarray(LUMA_601) ** 2).sum())
    assert 0.7 * luma < found.effects["noise of luma [1/255]"] < 1.4 * luma
    assert 0.9 < found.effects["sharpness at 0.19 cycles/px"] < 1.1
    assert Recipe.from_toml(found.recipe.to_toml()) == found.recipe


def test_a_camera_that_no_draw_resembles_is_strange(folders, tmp_path):
    """Stripes of a column's noise, which the recipe has not."""
    rng = np.random.default_rng(0)
    for i in range(3):
        stripes = 0.1 * rng.standard_normal((1, 160, 1)) * np.ones((160, 1, 3))
        write_png(tmp_path / f"{i}.png", np.clip(0.5 + stripes, 0, 1).astype(np.float32))
    found = adapt(tmp_path, CAMERAS, clean=folders / "clean", downsample=1, draws=128)
    assert found.strange > 0.5


def test_predictions_without_a_row_are_those_of_a_fit_without_it(rng):
    x, y = rng.standard_normal((20, 6)), rng.standard_normal((20, 1))
    y += x[:, :1]
    x, y = x - x.mean(0), y - y.mean(0)
    _, left_out, residual = _ridge(x, y, x[:2])
    wanted = []
    for penalty in 20 * np.geomspace(1e-4, 10, 12):
        rows = []
        for i in range(20):
            others = np.arange(20) != i
            a = np.hstack([x, np.ones((20, 1))])
            system = a[others].T @ a[others] + penalty * np.diag([1] * 6 + [0])
            rows.append(a[i] @ np.linalg.solve(system, a[others].T @ y[others]))
        wanted.append(np.asarray(rows))
    best = min(wanted, key=lambda rows: ((rows - y) ** 2).mean())
    np.testing.assert_allclose(left_out, best, atol=1e-10)
    np.testing.assert_allclose(residual, y - best, atol=1e-10)


def test_what_statistics_do_not_tell_stays(rng):
    """Two parameters, of which the statistics show one, and a switch that they show."""
    drawn = np.stack([rng.random(600), rng.random(600), rng.integers(0, 2, 600)], 1)
    shown = np.stack([drawn[:, 0], drawn[:, 2]], 1) @ rng.standard_normal((2, 8))
    statistics = shown + 0.02 * rng.standard_normal((600, 8))
    laws = (Uniform(0, 1), Uniform(0, 1), Bernoulli(0.5))
    seen = np.abs(drawn[:, 0] - 0.3) + np.abs(drawn[:, 2] - 1) < 0.03
    told, effects, kept, strange = _nearest(statistics, drawn[:, :1], drawn, statistics[seen], laws)
    assert told[0] > 0.98 and told[1] < 0.05 and told[2] > 0.98 and strange < 0.1
    np.testing.assert_allclose(effects, drawn[seen, 0].mean(), atol=0.02)
    a, b, c = (_narrowed(law, kept[:, i]) for i, law in enumerate(laws))
    assert 0.2 < a.low < 0.3 < a.high < 0.4
    assert b.high - b.low > 0.8 and c.p > 0.99


@pytest.mark.parametrize(
    "law",
    [
        Uniform(-1, 3), LogUniform(0.01, 1), PowerUniform(0, 0.2, 2), PowerUniform(-1, 1, 3),
        PowerUniform(-2, 1, 2), Normal(0, 1, -3, 2), Choice((75, 80, 85, 90)), Bernoulli(0.3), Uniform(2, 2),
    ],
)  # fmt: skip
def test_what_lies_as_it_was_drawn_keeps_its_range(law):
    """Of all kinds of distributions; and what lies in a part of it has that part."""
    drawn = np.asarray(law.sample(jax.random.key(1), (4000,)), np.float64)
    values = _scaled(law, drawn)
    assert np.isfinite(values).all()
    same = _narrowed(law, values)
    if isinstance(law, Bernoulli):
        assert abs(same.p - 0.3) < 0.03
        return
    if isinstance(law, Choice):
        assert same == law
    before, after = (_scaled(law, np.asarray(own.support)) for own in (law, same))
    np.testing.assert_allclose(after, before, atol=0.03 * np.ptp(before))
    middle = (drawn >= np.quantile(drawn, 0.4)) & (drawn <= np.quantile(drawn, 0.6))
    low, high = _narrowed(law, values[middle]).support
    span = drawn[middle].max() - drawn[middle].min()
    assert law.support[0] <= low + 1e-6 and high <= law.support[1] + 1e-6
    assert abs(low - drawn[middle].min()) <= 0.1 * span and abs(high - drawn[middle].max()) <= 0.1 * span


def test_a_camera_beyond_a_range_is_at_its_end(rng):
    """And no point there: what is not known of it is kept."""
    for law in (Uniform(0, 1), LogUniform(0.1, 1), Normal(0.5, 0.2, 0, 1)):
        end = _scaled(law, np.asarray(law.support))[1]
        found = _narrowed(law, end + rng.uniform(0.1, 0.3, 500))
        assert found.high == pytest.approx(1) and 0.5 < found.low < 0.95


def test_a_crop_beyond_all_draws_has_no_exact_parameter(rng):
    """What was kept for it is as wide as what the statistics leave open, at the end of what was drawn."""
    drawn = rng.random((300, 1))
    statistics = drawn + 0.1 * rng.standard_normal((300, 4))
    kept = _nearest(statistics, drawn, drawn, np.full((1, 4), 3.0), (Uniform(0, 5),)).kept
    assert 0.05 < np.ptp(kept) < 0.5 and 0.7 < kept.mean() < 1.2


def test_elements_of_a_vector_are_told_one_by_one(rng):
    """What is drawn evenly in a vector is so still: means of elements lie closer to the middle."""
    law = Uniform(0.0, 4.0)
    params = {"motion_blur": MotionBlur(lengths=rng.uniform(0, 4, (500, 3)), directions=np.zeros((500, 3)))}
    values = _values(params, {("motion_blur", "lengths"): law})
    assert values.shape == (500, 3)
    found = _narrowed(law, values)
    assert found.low < 0.1 and found.high > 3.9


def test_what_does_not_vary_is_not_told(rng):
    drawn = np.stack([rng.random(100), np.full(100, 0.1)], 1)
    statistics = np.stack([drawn[:, 0], rng.random(100)], 1)
    told = _nearest(statistics, drawn[:, :1], drawn, statistics[:5], (Uniform(0, 1), Uniform(0.1, 0.1))).told
    assert told[0] > 0.9 and told[1] == 0


def test_photographs_that_are_kept_as_crops(rng):
    """As `load_clean` keeps them beyond 2 GiB."""
    crops = np.stack([np.full((140, 140, 3), i * 65535 // 3, np.uint16) for i in range(4)])
    shades = {round(3 * float(_crop([crops], rng).mean())) for _ in range(40)}
    assert shades == {0, 1, 2, 3} and _crop([crops], rng).shape == (128, 128, 3)


def files(*named):
    return [_Header(float(quality), sampling) for quality, sampling in named]


def test_what_headers_state_is_in_the_narrowed_recipe(folders, tmp_path):
    for i, path in enumerate(sorted((folders / "noisy").iterdir())):
        write_jpeg(tmp_path / f"{i}.jpg", read_image(path), quality=(71, 75)[i % 2], subsampling="4:2:0")
    found = adapt(tmp_path, CAMERAS, clean=folders / "clean", downsample=1, draws=128)
    assert found.recipe.prior["jpeg"].quality == Uniform(71.0, 75.0)
    noise, quality = found.priors
    assert quality.after == Uniform(71.0, 75.0) and quality.told == 1.0
    assert found.recipe.prior["gaussian_noise"].std == noise.after != noise.before


def test_what_headers_state_is_taken_from_them():
    recipe = jaxisp.recipes.any_camera()
    laws = dict(_laws(recipe))
    found = recipe.override(_stated(recipe, laws, files((90, "4:2:0"), (94, "4:2:0")))).prior
    assert found["jpeg"].quality == Uniform(90.0, 94.0)
    for switch in ("use_camera", "use_jpeg", "use_chroma_subsampling"):
        assert found[switch].on == Bernoulli(1.0)
    assert found["chroma_subsampling"].vertical == Bernoulli(1.0)
    assert found["use_gaussian_noise"].on == recipe.prior["use_gaussian_noise"].on
    wide = recipe.override(_stated(recipe, laws, files((90, "4:2:2"), (90, "4:4:4")))).prior
    assert wide["use_chroma_subsampling"].on == Bernoulli(0.5)
    assert wide["chroma_subsampling"].vertical == Bernoulli(0.0)
    # a picture that is no JPEG, and a recipe that compresses nothing
    assert _stated(recipe, laws, [*files((90, "4:2:0")), None]) == {}
    assert _stated(jaxisp.recipes.awgn(), {}, files((90, "4:2:0"))) == {}
    assert _stated(CAMERAS, dict(_laws(CAMERAS)), files((77, "4:2:0")))["jpeg"]["quality"] == Uniform(77, 77)


def test_drawn_pictures_stand_beside_photographs_or_for_them(folders):
    """Those of 200 px are too small when made smaller by 3."""
    found = adapt(folders / "noisy", CAMERAS, draws=128)
    noise = found.priors[0].after
    assert noise.low < 0.03 < noise.high and not found.skipped


def test_clean_pictures_are_made_of_noisy_ones(tmp_path, rng):
    """Nearer to what is there than those made smaller alone, over all kinds: soft light most, leaves not.

    None is made of a pair's clean picture, or of one that is small.
    """
    source = tmp_path / "noisy"
    source.mkdir()
    clean = [drawn(kind, 1, 192) for kind in KINDS]
    noisy = [(c + 0.1 * rng.standard_normal(c.shape)).clip(0, 1).astype(np.float32) for c in clean]
    for i, picture in enumerate(noisy):
        write_png(source / f"{i}.png", picture)
    write_png(source / "b.clean.png", clean[0])
    write_png(source / "c.png", noisy[0][:100])
    (folder,) = clean_from(source, tmp_path / "clean", downsample=2)
    made = sorted((tmp_path / "clean").iterdir())
    truth, alone = ([downsample_linear(picture, 2) for picture in own] for own in (clean, noisy))
    denoised = [np.std(read_image(path) - own) for path, own in zip(made, truth, strict=True)]
    smaller = [np.std(picture - own) for picture, own in zip(alone, truth)]
    assert np.mean(denoised) < np.mean(smaller) and denoised[-1] < 0.6 * smaller[-1]
    assert clean_from(source, folder, downsample=2) == [folder]
    write_png(made[0], clean[0])
    with pytest.raises(InputError, match="stands there already and would be replaced"):
        clean_from(source, folder, downsample=2)


def test_clean_pictures_of_pairs_are_passed_over(folders, tmp_path):
    for name, other in (("0.png", "0.noisy.png"), ("1.png", "0.clean.png")):
        shutil.copy(folders / "noisy" / name, tmp_path / other)
    found = adapt([tmp_path, folders / "noisy"], CAMERAS, clean=folders / "clean", downsample=1, draws=64)
    assert [path for path, _ in found.skipped] == [str(tmp_path / "0.clean.png")]


def test_what_cannot_be_used_is_told(folders, tmp_path):
    write_png(tmp_path / "small.png", np.full((100, 300, 3), 0.5, np.float32))
    with pytest.raises(InputError, match="100x300 px is smaller than a crop of 128 px"):
        adapt(tmp_path, CAMERAS, clean=folders / "clean", downsample=1, draws=64)
    with pytest.raises(InputError, match="draws must be a whole number from 64 on, got 10"):
        adapt(folders / "noisy", CAMERAS, draws=10)
    with pytest.raises(InputError, match="seed = 4294967296: seeds go from 0 to 4294967295"):
        adapt(folders / "noisy", CAMERAS, seed=1 << 32)
    with pytest.raises(InputError, match="by their paths, got ndarray"):
        adapt(np.zeros((2, 128, 128, 3), np.float32), CAMERAS)
    light = Recipe(
        Chain((stage("gaussian_noise"), stage("srgb_oetf")), "light"),
        {"gaussian_noise": GaussianNoise(std=Uniform(0, 0.1))},
    )
    with pytest.raises(InputError, match="takes linear sRGB, not photographs"):
        adapt(folders / "noisy", light, clean=folders / "clean")
    fixed = CAMERAS.override(gaussian_noise={"std": 0.1}, jpeg={"quality": 90.0})
    with pytest.raises(InputError, match="draws no parameter"):
        adapt(folders / "noisy", fixed, clean=folders / "clean", draws=64)


def test_a_data_set_that_is_damaged_is_not_taken_for_pictures(folders, tmp_path, capsys):
    for name in ("0.noisy.png", "0.clean.png"):
        shutil.copy(folders / "noisy" / "0.png", tmp_path / name)
    (tmp_path / "dataset.toml").write_text("iso = [")
    assert main(["adapt", str(tmp_path), "-o", str(tmp_path / "out.toml")]) == 2
    assert "dataset.toml" in capsys.readouterr().err


def test_the_command_refuses_before_it_draws(folders, tmp_path, capsys):
    """And leaves nothing; what it was given is no output."""
    mine, out = tmp_path / "mine.toml", tmp_path / "out.toml"
    CAMERAS.save(mine)
    before = mine.read_text()
    options = ["adapt", str(folders / "noisy"), "--clean", str(folders / "clean"), "--recipe", str(mine)]
    refused = [
        (["-o", mine], "is an input, and would be overwritten"),
        (["-o", mine, "--recipe", f"{mine}-phases"], "is an input, and would be overwritten"),
        (["-o", folders / "clean" / "0.png"], "is an input, and would be overwritten"),
        (["-o", out, "--steps", "3"], "give --run RUN too"),
        (["-o", out, "--run", tmp_path / "run", "--start", folders / "noisy" / "0.png"], "holds no network"),
        (["-o", out, "--run", mine], "mine.toml"),
    ]
    for call, told in refused:
        assert main([*options, *map(str, call)]) == 2
        assert told in capsys.readouterr().err
    assert mine.read_text() == before and list(tmp_path.iterdir()) == [mine]


@pytest.mark.slow
def test_the_command_writes_a_recipe_and_trains_on_it(folders, tmp_path, capsys):
    CAMERAS.save(tmp_path / "cameras.toml")
    options = {"features": (8, 8), "depth": 1, "estimator": 4}
    save_network(
        tmp_path / "start.npz", make_model("levelnet", **options), "levelnet", options, light="encoded"
    )
    recipe, run = tmp_path / "adapted.toml", tmp_path / "run"
    call = [
        "adapt",
        folders / "noisy",
        "-o",
        recipe,
        "--recipe",
        tmp_path / "cameras.toml",
        "--downsample",
        2,
    ]
    call += ["--draws", 64, "--run", run, "--start", tmp_path / "start.npz", "--steps", 2, "--json"]
    assert main([str(part) for part in call]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["run"]["finished"] and told["priors"][0]["name"] == "gaussian_noise.std"
    assert Recipe.load(recipe).name == "cameras-adapted"
    out = tmp_path / "out.png"
    assert main(["denoise", "--run", str(run), str(folders / "noisy" / "0.png"), "-o", str(out)]) == 0
    assert read_image(out).shape == (200, 200, 3)
    made = sorted(path.name for path in (run / "clean").iterdir())
    assert len(made) == len(list((folders / "noisy").iterdir()))
    assert main([str(part) for part in call]) == 0  # finished, and its clean pictures are as they were
    assert sorted(path.name for path in (run / "clean").iterdir()) == made
    call[call.index("--steps") + 1] = 3
    assert main([str(part) for part in call]) == 2
    assert "begun with 2 steps" in capsys.readouterr().err
