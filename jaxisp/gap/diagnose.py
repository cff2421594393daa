"""Where the gap lies, which effect causes it, and how far it shrinks: the whole diagnosis of a data set."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxisp.checks import several
from jaxisp.errors import InputError
from jaxisp.gap.base.clean_noisy import clean_case
from jaxisp.gap.base.clean_reference import clean_case_on_reference
from jaxisp.gap.base.raw_jpeg import raw_case
from jaxisp.gap.base.two_jpegs import jpeg_case
from jaxisp.gap.case import Case, Tick
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.downstream.ceiling import reducible
from jaxisp.gap.downstream.options import Downstream
from jaxisp.gap.pairs.align_raw import Aligned
from jaxisp.gap.pairs.read import aligned_pairs
from jaxisp.gap.report.document import after, is_gap, report_of
from jaxisp.gap.report.page import write_report
from jaxisp.gap.report.pictures import candidate, example
from jaxisp.gap.report.simulator import simulator_of
from jaxisp.gap.search.verdict import Found, searched
from jaxisp.gap.simulator.effects import CLEAN_NOISY, JPEG_JPEG, RAW_JPEG
from jaxisp.io.datasets import Dataset, Loaded, open_dataset
from jaxisp.mixture import Mixture
from jaxisp.process.memory import give_back
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_degradation, find_recipe

SIMULATOR = "simulator.toml"


@dataclasses.dataclass(frozen=True, repr=False)
class Diagnosis:
    """What was found. `report` is report.json; `pictures` shows one held-out pair, and how what is left in
    all of them is spread over frequencies and neighbours. `simulator` is the base with the causes: a
    camera, which `jaxisp develop` takes, of RAW+JPEG pairs, and of others a recipe for `degrade` and `train`.
    It is None where a reference stands for the base."""

    report: dict[str, Any]
    pictures: dict[str, Any] = dataclasses.field(repr=False)
    simulator: Recipe | None = None

    def __repr__(self) -> str:
        gap, causes = self.report["gap"], ", ".join(self.causes) or "no cause"
        sizes = f"gap {gap['before']:.3g}, then {gap['after']:.3g}, floor {gap['floor']:.3g}"
        return f"Diagnosis: {self.verdict}, {causes}; {sizes}"

    @property
    def verdict(self) -> str:
        """ "effect", "none" or "unknown"."""
        return str(self.report["verdict"])

    @property
    def causes(self) -> list[str]:
        """The accepted effects, the largest first."""
        return [cause["effect"] for cause in self.report["causes"]]

    def save(self, folder: str | Path) -> Path:
        """Write report.json, report.html and, where there is one, simulator.toml; returns the page."""
        page = write_report(self.report, self.pictures, folder)
        if self.simulator is not None:
            self.simulator.save(page.with_name(SIMULATOR))
        return page


def diagnose(
    dataset: str | Path,
    camera: RecipeLike | None = None,
    *,
    recipe: RecipeLike | None = None,
    reference: str | Path | None = None,
    exclude: str | Sequence[str] = (),
    downstream: Downstream | None = None,
    criteria: Criteria | None = None,
    seed: int = 0,
    tick: Tick = lambda done, total, text: None,
) -> Diagnosis:
    """Diagnose the gap between a simulated camera and a real one's pictures.

    Args:
        dataset: a folder of RAW+JPEG, clean+noisy or JPEG+JPEG pairs.
        camera: the simulator, mosaic to encoded sRGB, as `jaxisp.fit` makes it, or its TOML file; its
            parameters are believed. Default: fit a plain camera to the pairs. For clean+noisy pairs the
            curve and matrix that take the clean picture to its sensor are fitted, and the sensor's noise,
            unless the camera has noise of its own.
        recipe: the simulator of clean+noisy pairs, encoded sRGB to encoded sRGB with a mosaic and its
            demosaicking. Its stages, their order and its constants are believed, tone and colour
            included. What it draws for each image it leaves open: that starts at its median and is fitted
            within the range of its prior, one value for all pairs.
        reference: a folder of pairs of the same camera without the effect in question: its module off,
            another setting or firmware. The base is fitted to these, and what it leaves of them is the floor.
            Pairs of the same RAW files tell most.
        exclude: names of effects that are not tried.
        downstream: how to train small denoisers without and with the accepted effects, or with what comes
            nearest, measured on the held-out pairs; needs clean+noisy pairs, two scenes or more. Default:
            do not train.
        criteria: what the verdict is decided by; None: those of the kind of pairs.
        seed: of the simulated noise.
        tick: called with (done, total, text).

    Raises:
        InputError: no such folder, no usable pair, an unknown effect, a simulator that cannot be a base
            (no mosaic or demosaicking, stages drawn at random, another domain), a camera and a recipe at
            once, a mixture, a recipe for RAW+JPEG pairs, or `downstream`.
    """
    clock = time.perf_counter()
    if camera is not None and recipe is not None:
        raise InputError("give a camera or a recipe, not both: each is a whole simulator")
    given = None if camera is None else find_recipe(camera)
    simulator = None if recipe is None else find_degradation(recipe)
    if isinstance(simulator, Mixture):
        raise InputError(
            f"a mixture ({simulator.name}) is several cameras, a diagnosis is of one: give one of its recipes"
        )
    data = open_dataset(dataset)
    _check_kind(dataset, data.kind, given, simulator, downstream)
    other = None if reference is None else _opened_reference(reference, data.kind, given, simulator)
    count = max(len(own.pairs) for own in (data, other) if own is not None)
    aligned = aligned_pairs(data, count)
    others = None if other is None else aligned_pairs(other, count)
    give_back()
    criteria = CRITERIA[data.kind] if criteria is None else criteria
    case = _with_base(data.kind, aligned, given, simulator, others, several(exclude), criteria, seed, tick)
    give_back()
    gap = case.gap()
    pictures = example(case, case.point, "before")
    found = searched(case, gap, tick)
    pictures |= candidate(case, found)
    gap = found.gap or gap
    lower = None
    if is_gap(case, gap, found):
        most = case.criteria.most_causes
        tick(most - 1, most, "what flexible models reach")
        give_back()
        refits = [t.after for t in (*found.trials.values(), *found.nearest)]
        lower = reducible(case, gap, found.point, after(gap, found), refits)
    report = report_of(case, gap, found, aligned, lower)
    if downstream is not None:
        report["downstream"] = _trained(case, found, downstream, tick)
    if found.causes:
        pictures |= example(case, found.point, "after")
    report["seconds"] = round(time.perf_counter() - clock, 2)
    return Diagnosis(
        report, pictures, simulator_of(case, found.point, [c["effect"] for c in report["causes"]])
    )


def _check_kind(
    dataset: str | Path,
    kind: str,
    camera: Recipe | None,
    recipe: Recipe | None,
    downstream: Downstream | None,
) -> None:
    """Raise InputError where pairs of this kind cannot be asked for that."""
    if kind == JPEG_JPEG and (camera or recipe):
        raise InputError(
            f"{dataset}: holds two JPEGs of each scene, the first of which is the simulator's input; a "
            "camera or a recipe is for RAW+JPEG or clean+noisy pairs"
        )
    if kind == RAW_JPEG and recipe is not None:
        raise InputError(
            f"{dataset}: a recipe simulates clean+noisy pairs, these are RAW+JPEG; give a camera (--camera)"
        )
    if kind != CLEAN_NOISY and downstream is not None:
        raise InputError(
            f"{dataset}: denoisers (--downstream) are measured against clean pictures, which these pairs "
            "do not have; give clean+noisy pairs"
        )


def _opened_reference(folder: str | Path, kind: str, camera: Recipe | None, recipe: Recipe | None) -> Dataset:
    """A reference. Raises InputError where the folder cannot be one."""
    if camera is not None or recipe is not None:
        raise InputError("give a reference, or a camera or recipe: a base is fitted to one or is the other")
    if kind == JPEG_JPEG:
        raise InputError(f"{folder}: two JPEGs of a scene need no reference: the first of them is one")
    data = open_dataset(folder)
    if data.kind != kind:
        raise InputError(f"{folder}: holds {data.kind} pairs, the set to be diagnosed {kind} pairs")
    return data


def _with_base(
    kind: str,
    aligned: Aligned,
    camera: Recipe | None,
    recipe: Recipe | None,
    reference: Aligned | None,
    exclude: Sequence[str],
    criteria: Criteria,
    seed: int,
    tick: Tick,
) -> Case:
    """The pairs with the base of their kind before them."""
    loaded = _doubled(aligned)
    if kind == RAW_JPEG:
        others = () if reference is None else _doubled(reference)
        return raw_case(loaded, camera, exclude, tick, criteria=criteria, reference=others)
    if kind == JPEG_JPEG:
        return jpeg_case(loaded, exclude, tick, criteria=criteria)
    if reference is not None:
        return clean_case_on_reference(loaded, _doubled(reference), exclude, seed, tick, criteria=criteria)
    uncertain = [row["name"] for row in aligned.rows if not row["certain"]]
    simulator, is_camera = camera or recipe, camera is not None
    return clean_case(
        loaded, simulator, exclude, seed, tick,
        is_camera=is_camera, uncertain=uncertain, criteria=criteria,
    )  # fmt: skip


def _doubled(aligned: Aligned) -> list[Loaded]:
    """The pairs; one that is alone twice, as its tiles are told apart by masks."""
    return 2 * aligned.kept if len(aligned.kept) == 1 else aligned.kept


def _trained(case: Case, found: Found, how: Downstream, tick: Tick) -> dict[str, Any]:
    """Denoisers without and with the causes, or with the nearest candidates if none was accepted."""
    from jaxisp.gap.downstream.denoisers import measure_downstream

    near = found.refused
    if not found.causes and near is None:
        return {"skipped": "no effect comes near: there is nothing to train with and without"}
    point, named = (found.point, found.causes) if near is None else (near.point, near.causes)
    measured = measure_downstream(case, {"without": case.point, "with": point}, how, tick)
    return measured | {"effects": [trial.effect for trial, _ in named]}


def diagnose_folder(folder: str | Path, **options: Any) -> dict[str, Any]:
    """`diagnose`, as the dictionary that report.json holds."""
    return diagnose(folder, **options).report
