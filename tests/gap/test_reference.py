"""A base that is fitted to the same camera without the effect, and taken over."""

import dataclasses
import json

import numpy as np
import pytest

from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.gap import EFFECTS, diagnose
from jaxisp.gap.base.plain_raw import Base, plain_parts
from jaxisp.gap.base.reference import taken_over
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.pairs.align_raw import raw_pairs
from jaxisp.gap.pairs.same_raw import of_same_raws
from jaxisp.gap.simulator.effects import candidates
from jaxisp.gap.simulator.model import build, plain_freedom
from jaxisp.io import open_dataset
from jaxisp.stages.balance import ColorMatrix
from tests.gap.schema import keeps_the_schema
from tests.gap.test_given_raw import write

ALL = candidates("raw+jpeg")


def loaded_of(folder):
    return [pair.load() for pair in open_dataset(folder).pairs]


def fitted_to(loaded, pairs):
    """The plain base as it starts."""
    chain, params, per_pair = plain_parts(loaded, pairs, np.ones((len(loaded), 3)))
    return Base(build(chain, params, per_pair, plain_freedom(), []))


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """Pairs of a camera, of the same RAW files with a brighter picture, and of other RAW files."""
    off, on, other = (tmp_path_factory.mktemp(name) for name in ("off", "on", "other"))
    write(off, count=4, size=96)
    write(on, lambda m: m**0.9, count=4, size=96)
    for path in off.glob("*.raw.npy"):
        np.save(on / path.name, np.load(path))
    write(other, count=8, size=96)
    for path in list(other.glob("*")):
        if path.stem.removesuffix(".raw") in {p.stem for p in off.glob("*.png")}:
            path.unlink()
    return {"off": off, "on": on, "other": other}


def over(sets, which, reference):
    loaded, theirs = loaded_of(sets[which]), loaded_of(sets[reference])
    pairs, others = raw_pairs(loaded), raw_pairs(theirs)
    _, same = of_same_raws(loaded, theirs)
    return pairs, others, taken_over(loaded, pairs, theirs, others, same, fitted_to(theirs, others), ALL)


def test_beside_the_same_raw_files_the_base_makes_the_references_pictures(sets):
    pairs, others, taken = over(sets, "on", "off")
    z = np.zeros(len(taken.model.coordinates))
    made = taken.model.render(z, pairs.light)
    np.testing.assert_allclose(made, others.pictures, atol=2e-6)
    assert taken.gap is None and taken.model.base == ()
    own = taken.model.take([1]).render(z, pairs.light[1:2])
    np.testing.assert_allclose(own, others.pictures[1:2], atol=2e-6)


def test_effects_that_a_fitted_base_absorbs_are_tried_on_it(sets):
    _, _, taken = over(sets, "on", "off")
    assert {"tone_curve", "color_matrix", "black_level_offset", "demosaicking"} <= set(taken.model.effects)


def test_effects_act_on_the_references_pictures(sets):
    """A blur of the lens blurs what the base does not model too."""
    pairs, others, taken = over(sets, "on", "off")
    model = taken.model
    names = [n.name for n in model.chain.nodes]
    first = names.index("remainder")
    assert all(names.index(f"use_{e}") > first for e in ("optical_blur", "vignetting", "sharpening"))
    assert all(names.index(f"use_{e}") < first for e in ("crosstalk", "white_balance"))
    z = np.zeros(len(model.coordinates))
    z[model.indices(["optical_blur"])[0]] = 1.0
    loaded = loaded_of(sets["on"])
    theirs = loaded_of(sets["off"])
    strange = [dataclasses.replace(p, picture=1 - p.picture) for p in theirs]
    turned = taken_over(loaded, pairs, theirs, others, strange, fitted_to(theirs, others), ALL).model
    blurred = turned.render(z, pairs.light)
    assert np.var(np.diff(blurred, axis=1)) < 0.5 * np.var(np.diff(raw_pairs(strange).pictures, axis=1))


def test_a_known_effect_is_measured_under_a_wrong_base(sets):
    """What the base errs by is on both sides, so that it cancels; with the base alone it biases the fit."""
    amount = 1.3
    theirs = loaded_of(sets["off"])

    def saturated(picture):
        grey = picture @ np.array([0.299, 0.587, 0.114], np.float32)
        return np.float32(np.clip(grey[..., None] + amount * (picture - grey[..., None]), 0, 1))

    loaded = [dataclasses.replace(p, picture=saturated(p.picture)) for p in theirs]
    pairs, others = raw_pairs(loaded), raw_pairs(theirs)
    base = fitted_to(theirs, others)
    turned = base.model.shared["color_matrix"].matrix @ np.float32(
        [[0.9, 0.2, 0], [0, 0.7, 0], [0, 0.3, 0.8]]
    )
    wrong = base._replace(
        model=base.model.with_shared(base.model.shared | {"color_matrix": ColorMatrix(matrix=turned)})
    )
    found = []
    for same in (of_same_raws(loaded, theirs)[1], []):
        model = taken_over(loaded, pairs, theirs, others, same, wrong, ALL).model
        objective, own = PixelObjective.of(pairs), model.indices(["saturation"])
        fitted = fit(objective, objective.at(model, np.zeros(len(model.coordinates))), own, steps=4).point
        found.append(model.params(fitted.z)["saturation"].amount)
    assert found[0] == pytest.approx(amount, abs=0.01)
    assert abs(found[1] - amount) > 0.1


def test_beside_other_raw_files_the_bases_gap_is_the_floor(sets):
    pairs, _, taken = over(sets, "on", "other")
    assert taken.same is None and taken.gap > 0
    made = taken.model.render(np.zeros(len(taken.model.coordinates)), pairs.light)
    assert np.isfinite(made).all() and np.ptp(made) > 0.1


def test_another_pattern_is_another_camera(sets):
    loaded, theirs = loaded_of(sets["on"]), loaded_of(sets["off"])
    turned = [dataclasses.replace(p, raw=dataclasses.replace(p.raw, cfa="BGGR")) for p in theirs]
    with pytest.raises(InputError, match="colour filter array"):
        taken_over(loaded, raw_pairs(loaded), turned, raw_pairs(turned), [], None, ALL)


def test_a_reference_of_another_kind_is_refused(sets, tmp_path):
    with pytest.raises(InputError, match="give a reference, or a camera"):
        diagnose(sets["on"], camera="phone", reference=sets["off"])


@pytest.mark.slow
def test_a_tone_that_a_plain_base_absorbs_is_named_beside_a_reference(sets, tmp_path, capsys):
    out = tmp_path / "out"
    tried = {"tone_curve", "saturation", "vignetting"}
    excluded = ",".join(sorted(set(EFFECTS) - tried))
    call = ["diagnose", str(sets["on"]), "-o", str(out), "--exclude", excluded, "--json"]
    assert main([*call, "--reference", str(sets["off"])]) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    keeps_the_schema(report)
    assert [c["effect"] for c in report["causes"]][:1] == ["tone_curve"]
    assert report["gap"]["reference"] >= 0 and report["base"]["given"].startswith("plain camera")
    assert main(call) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["base"]["absorbed"]["tone_curve"] > 0.5
