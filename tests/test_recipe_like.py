"""Whatever stands for a recipe is taken wherever one is."""

import importlib
import inspect
import typing
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from PIL import Image

import jaxisp
from jaxisp import Chain, InputError, stage
from jaxisp.calibrate import with_noise
from jaxisp.camera import develop
from jaxisp.data import Batches, DegradedBatches
from jaxisp.data.loader import degrader
from jaxisp.data.work import Work
from jaxisp.fit import fit_dataset, prior_from_cameras
from jaxisp.gap import diagnose
from jaxisp.generate import degrade_files
from jaxisp.interop import DegradeExamples, IspModel
from jaxisp.io import write_png
from jaxisp.recipes import RecipeLike, any_phase, find_degradation, find_recipe, mix
from jaxisp.testing import smooth_image
from jaxisp.train import TrainConfig, train

KEY = jax.random.key(0)
CLEAN = smooth_image((32, 32, 3)).astype(np.float32)


class Patches:
    """As `CleanPatches`, of one picture."""

    def batch(self, indices):
        return np.stack([CLEAN for _ in indices])

    def __len__(self):
        return 4


def forms(folder: Path):
    """All that may stand for the noise of `awgn`, and for a mixture of it."""
    recipe = jaxisp.recipes.awgn()
    mixture = mix({"awgn": 1.0})
    recipe.save(folder / "one.toml")
    mixture.save(folder / "several.toml")
    one = [recipe, "awgn", folder / "one.toml", str(folder / "one.toml")]
    return one, [mixture, "awgn=1", folder / "several.toml"]


def torch_batches(form):
    torch = pytest.importorskip("torch")
    from jaxisp.interop import torch as drop_in

    batch = {"clean": torch.from_numpy(np.moveaxis(CLEAN, -1, 0)[None].copy()), "index": torch.tensor([0])}
    (one,) = drop_in.degraded([batch], form)
    noisy, _ = next(iter(drop_in.DegradedBatches(Patches(), form, batch=1)))
    assert torch.equal(noisy, one[0])
    return np.moveaxis(noisy.numpy()[0], 0, -1)


def batches(form):
    with Batches(Patches(), form, batch=1) as found:
        return np.asarray(next(found)[0])[0]


def picture(form):
    return np.asarray(
        DegradeExamples(form)({"image": [Image.fromarray(np.uint8(255 * CLEAN))]}, [0])["noisy"][0]
    )


def files(form, folder):
    write_png(folder / "in" / "a.png", CLEAN)
    degrade_files([folder / "in"], folder / "out", form)
    work = Work([folder / "in"], form)
    assert work.degradation.name == find_degradation(form).name
    return np.asarray(Image.open(folder / "out" / "a_000.noisy.png"))


PLACES = {
    "IspModel": lambda form, _: IspModel(form)(CLEAN)[0],
    "DegradeExamples": lambda form, _: picture(form),
    "Batches": lambda form, _: batches(form),
    "DegradedBatches": lambda form, _: DegradedBatches(Patches(), form, batch=1)[0]["noisy"],
    "degrader": lambda form, _: degrader(form, KEY)(CLEAN[None], np.int32([0])),
    "degrade_files": files,
    "torch": lambda form, _: torch_batches(form),
}


@pytest.mark.parametrize("place", PLACES)
def test_all_forms_give_the_same_pictures(place, tmp_path):
    own, several = forms(tmp_path)
    found = []
    # one way to each text and file; what stands for what is one function's
    for i, form in enumerate((own[0], own[1], several[0], several[2])):
        folder = tmp_path / str(i)
        (folder / "in").mkdir(parents=True)
        found.append(np.asarray(PLACES[place](form, folder)))
    assert not np.array_equal(found[0], CLEAN)
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


def test_forms_are_found(tmp_path):
    own, several = forms(tmp_path)
    assert all(find_degradation(form) == own[0] == find_recipe(form) for form in own)
    assert all(find_degradation(form) == several[0] for form in several)


def test_a_chain_stands_for_its_defaults():
    chain = Chain((stage("srgb_eotf"), stage("gaussian_noise"), stage("srgb_oetf")), "noise")
    noisy = IspModel(chain)(CLEAN)[0]
    np.testing.assert_array_equal(noisy, IspModel(jaxisp.Recipe(chain, {}))(CLEAN)[0])
    assert find_degradation(chain) == jaxisp.Recipe(chain, {}) and not np.array_equal(noisy, CLEAN)


def test_where_one_recipe_is_meant_a_mixture_is_refused(tmp_path):
    mixture = mix({"phone": 0.5, "clean": 0.5})
    mixture.save(tmp_path / "several.toml")
    noise = object()
    for call in (
        lambda form: any_phase(form),
        lambda form: with_noise(form, noise),
        lambda form: develop(SimpleNamespace(cfa="RGGB"), form),
        lambda form: prior_from_cameras(form),
        lambda form: prior_from_cameras([form]),
        lambda form: fit_dataset(_pairs(tmp_path), start=form),
        lambda form: diagnose(tmp_path, recipe=form),
        lambda form: diagnose(tmp_path, camera=form),
        find_recipe,
    ):
        for form in (mixture, tmp_path / "several.toml"):
            with pytest.raises(InputError, match=r"several (recipes|cameras)"):
                call(form)
    assert any_phase("phone") == any_phase(jaxisp.recipes.phone())


def _pairs(folder):
    (folder / "a.dng").touch()
    (folder / "a.jpg").touch()
    return folder


def test_a_run_takes_names_and_train_takes_all(tmp_path, monkeypatch):
    asked = []

    class Run:
        def __init__(self, config, run, recipe, *_):
            asked.append(recipe)

        def train(self):
            return None

    monkeypatch.setattr("jaxisp.train.trainer._Run", Run)
    own, several = forms(tmp_path)
    for i, form in enumerate((*own, *several)):
        train(TrainConfig(clean="photos", recipe="any"), tmp_path / f"run{i}", recipe=form)
        assert asked[-1] == find_degradation(form)
    config = TrainConfig(clean="photos", recipe=tmp_path / "one.toml")
    assert config.clean == ("photos",) and config.recipe == str(tmp_path / "one.toml")
    with pytest.raises(InputError, match=r"expected a name or a TOML file; train\(config, run, recipe=...\)"):
        TrainConfig(clean=("photos",), recipe=own[0])


def test_what_is_no_recipe_is_told_in_words(tmp_path):
    for wrong in (None, 3, ["awgn"]):
        with pytest.raises(InputError, match="a recipe is a Recipe, a Chain, a name"):
            IspModel(wrong)
    with pytest.raises(InputError, match="no recipe named 'fone'; is it phone"):
        Batches(Patches(), "fone")
    for call in (jaxisp.run, jaxisp.run_batch, jaxisp.run_in_strips):
        with pytest.raises(
            TypeError, match=f"{call.__name__} takes stages and pipelines, got a Recipe: give its .chain"
        ):
            call(jaxisp.recipes.awgn(), {}, CLEAN)
        with pytest.raises(TypeError, match=r"got 'clip': stage\('clip'\)\?"):
            call("clip", {}, CLEAN)
    with pytest.raises(TypeError, match="picture_after takes stages and pipelines, got a Recipe"):
        jaxisp.explore.picture_after(jaxisp.recipes.awgn(), CLEAN)
    with pytest.raises(TypeError, match="Recipe takes a Chain"):
        jaxisp.Recipe("awgn", {})


def test_every_public_place_takes_all_forms():
    """A parameter `recipe` or `camera` of a public function may be anything that stands for one."""
    modules = "adapt calibrate camera data data.loader fit gap generate interop recipes train"
    seen = set()
    for module in (importlib.import_module(f"jaxisp.{name}") for name in modules.split()):
        own = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__]
        for name in getattr(module, "__all__", [n for n in own if not n.startswith("_")]):
            value = getattr(module, name)
            call = value.__init__ if inspect.isclass(value) else value
            others = ("TrainConfig", "low_light", "Adaptation")
            if name in others or not inspect.isfunction(call):
                continue  # names alone, of cameras too; what was found
            # the camera of a class is what was found, or a name
            kinds = {"recipe"} if inspect.isclass(value) else {"recipe", "camera"}
            for parameter in inspect.signature(call).parameters.keys() & kinds:
                hint = typing.get_type_hints(call)[parameter]
                assert hint in (RecipeLike, RecipeLike | None), f"{name}: {hint}"
                seen.add(name)
    assert {"any_phase", "batches", "develop", "diagnose", "degrade_files", "train", "with_noise"} <= seen


@pytest.mark.parametrize("phases", [False, True])
def test_shares_may_have_blanks_and_name_a_recipe_once(phases):
    """A second share of a name would silently stand for the first."""
    assert find_degradation("phone = 0.5, clean=0.5", phases=phases).shares == (0.5, 0.5)
    for text in ("phone=0.5,phone=0.5", "awgn=0.25,clean=0.5,awgn=0.5"):
        with pytest.raises(InputError, match="has two shares"):
            find_degradation(text, phases=phases)
