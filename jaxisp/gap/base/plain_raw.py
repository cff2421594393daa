"""The plain camera that is fitted to RAW+JPEG pairs."""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np

from jaxisp.color import srgb_to_linear
from jaxisp.errors import InputError
from jaxisp.gap.base.absorbed import taken_up
from jaxisp.gap.base.palette import is_colourless, start_matrix, typical_matrix
from jaxisp.gap.case import LEAST_UNIT, NULL_DROP, Gap
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import Problem, floor_difference, floor_errors
from jaxisp.gap.pairs.crops import common_crop
from jaxisp.gap.pairs.headers import stated_warp
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.simulator.effects import RAW_JPEG, Effect
from jaxisp.gap.simulator.model import (
    ROOTED,
    Choice,
    Coordinate,
    Model,
    build,
    plain_camera,
    plain_freedom,
    rooted,
)
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import run, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking, demosaicking
from jaxisp.stages.optics import RectilinearWarp


class Base(NamedTuple):
    """What is put before RAW+JPEG pairs.

    Attributes:
        model: the base, with every effect in it, off.
        absorbed: what the base took up of each effect that is part of it, as a share of the error that would
            be there without.
        choices: how it may demosaick besides.
        rival: where it demosaicks square roots, the best choice that does not: halved chroma is imitated by
            them.
        unsaid: effects that are part of it and that these pairs say nothing of: it has what is usual.
    """

    model: Model
    absorbed: Mapping[str, float] = MappingProxyType({})
    choices: Sequence[Choice] = ()
    rival: Choice | None = None
    unsaid: tuple[str, ...] = ()


def raw_model(
    loaded: Sequence[Loaded], pairs: Pairs, effects: Sequence[Effect], fit_on: Sequence[int]
) -> Base:
    """The plain camera fitted to RAW+JPEG pairs, its demosaicker the best of all; see `fit_base`."""
    raws = [p.raw for p in loaded if p.raw is not None]
    cfa, jpeg = raws[0].cfa, loaded[0].jpeg
    if len(raws) < len(loaded) or any(raw.cfa != cfa for raw in raws):
        raise InputError("the RAW files have different colour filter arrays; diagnose one camera at a time")
    sampling = jpeg.subsampling if jpeg else "4:4:4"
    gains, matrix, usual = _start(raws, pairs, cfa)
    balance = WhiteBalance(gains=np.asarray(gains, np.float32))
    per_pair = {"mosaic_white_balance": balance, "later_balance": _neutral(balance)}
    parts = [(c[0].start, c[1].start) for c in common_crop(loaded)]
    shape = (pairs.mask.shape[1], pairs.mask.shape[2])
    warps = [stated_warp(raw, start, shape) for raw, start in zip(raws, parts)]
    warped = any(w is not None for w in warps)
    if warped:
        own = [w or RectilinearWarp() for w in warps]
        per_pair["rectilinear_warp"] = jax.tree.map(lambda *v: np.stack(v), *own)
    chain, params = plain_camera(cfa, subsampling=sampling, warped=warped)

    def fitted(matrix: np.ndarray, free: Sequence[Coordinate]) -> Base:
        start = params | {"color_matrix": ColorMatrix(matrix=np.asarray(np.clip(matrix, -4, 4), np.float32))}
        return fit_base(build(chain, start, per_pair, free, effects), pairs, fit_on)

    found = fitted(matrix, plain_freedom())
    if usual is None or _all_told(found, pairs, fit_on, [p.jpeg for p in loaded]):
        return found
    held = fitted(usual, [c for c in plain_freedom() if c.node != "color_matrix"])
    said = {name: share for name, share in held.absorbed.items() if name != "color_matrix"}
    return held._replace(absorbed=said, unsaid=("color_matrix",))


def _all_told(base: Base, pairs: Pairs, which: Sequence[int], files: Sequence[Jpeg | None]) -> bool:
    """Whether it leaves no more of these pairs than rounding and the files' compression do."""
    problem, which = Problem(base.model, pairs), list(which)
    problem.weigh(problem.robust_weights())
    floor = floor_errors(problem, floor_difference(problem, files))[which].mean()
    left = Gap(float(problem.errors(problem.z)[which].mean()), float(floor), LEAST_UNIT[RAW_JPEG])
    return not left.exceeds(NULL_DROP[RAW_JPEG])


def fit_base(model: Model, pairs: Pairs, fit_on: Sequence[int]) -> Base:
    """The base fitted, with the demosaicker that explains the pairs best: before or after white balance, of
    linear values or of their square roots."""
    whole = Problem(model, pairs)
    part, seen = whole.take(fit_on), range(len(fit_on))
    fit(part, model.base_indices, seen, steps=6)
    part.weigh(part.robust_weights(), part.z)
    found = choices(model)
    fitted, roots = part.model, [_on_roots(choice) for choice in found]

    def error_of(choice: Choice) -> float:
        part.model = fitted.chosen(choice.take(fit_on))
        return float(part.errors(part.z).mean())

    errors, of_roots = ([error_of(choice) for choice in some] for some in (found, roots))
    linear, root = found[int(np.argmin(errors))], roots[int(np.argmin(of_roots))]
    rooted_best = min(of_roots) < ROOTED * min(errors)
    best, rival = (root, linear) if rooted_best else (linear, None)
    part.model = fitted
    part.choose(best.take(fit_on))
    fit(part, model.base_indices, seen, steps=4)
    absorbed = taken_up(part, seen, part.model.moved(part.z), model.shared)
    absorbed["demosaicking"] = 1 - min(errors) / max(errors)
    return Base(model.chosen(best).moved(part.z), absorbed, [*found, root], rival)


def choices(model: Model) -> list[Choice]:
    """Each demosaicker, before and after white balance."""
    first = model.per_pair["mosaic_white_balance"]
    orders = [(first, _neutral(first)), (_neutral(first), first)]
    return [
        Choice(
            {"demosaicking": Demosaicking(shares=shares)} | rooted(False),
            {"mosaic_white_balance": early, "later_balance": late},
        )
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
        for early, late in orders
    ]


def _on_roots(choice: Choice) -> Choice:
    return dataclasses.replace(choice, shared=choice.shared | rooted(True))


def _neutral(balance: WhiteBalance) -> WhiteBalance:
    return WhiteBalance(gains=np.ones_like(balance.gains))


def _start(raws: Sequence[Raw], pairs: Pairs, cfa: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Where the fit of a base begins: (N, 3) gains, and a (3, 3) colour matrix by least squares. Of scenes
    without colours a usual matrix too: what is fitted to the noise in their greys imitates whatever took of
    that, compression first."""
    gains = np.stack([np.ones(3) if raw.white_balanced else raw.white_balance for raw in raws])
    silent = np.allclose(gains, 1) and not raws[0].white_balanced
    light, linear = _balanced(pairs, cfa, gains), srgb_to_linear(pairs.pictures)
    grey = is_colourless(light, pairs.mask)

    def shade(pixels: np.ndarray) -> np.ndarray:
        return np.asarray(pixels[pairs.mask].mean(0))

    if silent:
        if grey:
            white = shade(light) / shade(linear)
        else:  # the matrix's own
            white = np.linalg.solve(start_matrix(light, pairs.pictures, pairs.mask), np.ones(3))
        gains = np.clip(white[1] / white, 0.125, 8)[None].repeat(len(raws), 0)
        light = _balanced(pairs, cfa, gains)
    matrix = start_matrix(light, pairs.pictures, pairs.mask)
    if not grey:
        return gains, matrix, None
    return gains, matrix, typical_matrix(shade(linear) / (typical_matrix(np.ones(3)) @ shade(light)))


def _balanced(pairs: Pairs, cfa: str, gains: np.ndarray) -> np.ndarray:
    """(N, H, W, 3) the mosaics, white balanced by (N, 3) gains and demosaicked."""
    rgb = []
    balanced, flat = (
        stage("mosaic_white_balance", cfa=cfa),
        stage(demosaicking, cfa=cfa, algorithm="bilinear"),
    )
    for mosaic, gain in zip(pairs.light, gains):
        own = run(balanced, {balanced.name: WhiteBalance(gains=np.asarray(gain, np.float32))}, mosaic)
        rgb.append(np.asarray(run(flat, flat.init(), own)))
    return np.stack(rgb)
