"""The plain camera that is fitted to RAW+JPEG pairs."""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np

from jaxisp.color import srgb_to_linear
from jaxisp.gap.base.absorbed import absorbed_shares
from jaxisp.gap.base.palette import is_colourless, start_matrix, typical_matrix
from jaxisp.gap.case import Gap
from jaxisp.gap.criteria import CRITERIA, Criteria
from jaxisp.gap.gauss_newton import fit
from jaxisp.gap.objective.pixels import PixelObjective
from jaxisp.gap.objective.protocol import Point
from jaxisp.gap.pairs.crops import common_crop
from jaxisp.gap.pairs.headers import raws_of, stated_warp
from jaxisp.gap.pairs.pairs import Pairs
from jaxisp.gap.parallel import parallel_map
from jaxisp.gap.simulator.effects import RAW_JPEG, Effect
from jaxisp.gap.simulator.model import (
    ROOTED,
    Coordinate,
    Model,
    Variant,
    build,
    plain_camera,
    plain_freedom,
    rooted,
)
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Params, run, stage
from jaxisp.stages.balance import ColorMatrix, WhiteBalance
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking, demosaicking
from jaxisp.stages.optics import RectilinearWarp

_NEAREST = 12
"""Demosaickers, in either order with white balance, that are tried again beside each effect."""
_PARTNERS, _SHARES = 3, (0.2, 0.35, 0.5)
"""Algorithms that the best is mixed with, and their shares."""
_MIXED = 0.97
"""Share of the best algorithm's error that a mix must leave to be taken for it."""


class Base(NamedTuple):
    """The base of RAW+JPEG pairs.

    Attributes:
        model: the base with every effect, switched off.
        absorbed: share of the error that each effect of the base absorbs, see `absorbed_shares`.
        choices: other demosaickers.
        rival: if the base demosaicks square roots, the best choice that does not, since square roots imitate
            halved chroma.
        unidentifiable: effects of the base that these pairs cannot show; it has typical values for them.
    """

    model: Model
    absorbed: Mapping[str, float | None] = MappingProxyType({})
    choices: Sequence[Variant] = ()
    rival: Variant | None = None
    unidentifiable: tuple[str, ...] = ()


def raw_model(
    loaded: Sequence[Loaded],
    pairs: Pairs,
    effects: Sequence[Effect],
    fit_on: Sequence[int],
    criteria: Criteria = CRITERIA[RAW_JPEG],
) -> Base:
    """Fit the plain camera to RAW+JPEG pairs, with the best demosaicker; see `fit_base`."""
    raws, cfa = raws_of(loaded)
    gains, matrix, usual = _start(raws, pairs, cfa)
    chain, params, per_pair = plain_parts(loaded, pairs, gains)

    def fitted(matrix: np.ndarray, free: Sequence[Coordinate]) -> Base:
        start = params | {"color_matrix": ColorMatrix(matrix=np.asarray(np.clip(matrix, -4, 4), np.float32))}
        return fit_base(build(chain, start, per_pair, free, effects), pairs, fit_on)

    found = fitted(matrix, plain_freedom())
    if usual is None or _at_floor(found, pairs, fit_on, [p.jpeg for p in loaded], criteria):
        return found
    held = fitted(usual, [c for c in plain_freedom() if c.node != "color_matrix"])
    absorbed = {name: share for name, share in held.absorbed.items() if name != "color_matrix"}
    return held._replace(absorbed=absorbed, unidentifiable=("color_matrix",))


def plain_parts(loaded: Sequence[Loaded], pairs: Pairs, gains: np.ndarray) -> tuple[Chain, Params, Params]:
    """The plain camera of RAW+JPEG pairs before it is fitted, with what their files state.

    Args:
        loaded: the pairs.
        pairs: the same, cropped alike.
        gains: (N, 3) white-balance gains; they come before demosaicking.

    Returns:
        the chain; its parameters; those of each pair.
    """
    (raws, cfa), jpeg = raws_of(loaded), loaded[0].jpeg
    sampling = jpeg.subsampling if jpeg else "4:4:4"
    balance = WhiteBalance(gains=np.asarray(gains, np.float32))
    per_pair: Params = {"mosaic_white_balance": balance, "later_balance": _neutral(balance)}
    parts = [(c[0].start, c[1].start) for c in common_crop(loaded)]
    shape = (pairs.mask.shape[1], pairs.mask.shape[2])
    warps = [stated_warp(raw, start, shape) for raw, start in zip(raws, parts)]
    warped = any(w is not None for w in warps)
    if warped:
        own = [w or RectilinearWarp() for w in warps]
        per_pair["rectilinear_warp"] = jax.tree.map(lambda *v: np.stack(v), *own)
    return (*plain_camera(cfa, subsampling=sampling, warped=warped), per_pair)


def stated_gains(raws: Sequence[Raw]) -> np.ndarray | None:
    """(N, 3) white-balance gains that RAW files state, of those that are balanced already ones; None where
    they state none."""
    gains = np.stack([np.ones(3) if raw.white_balanced else raw.white_balance for raw in raws])
    silent = np.allclose(gains, 1) and not raws[0].white_balanced
    return None if silent else gains


def _at_floor(
    base: Base, pairs: Pairs, which: Sequence[int], files: Sequence[Jpeg | None], criteria: Criteria
) -> bool:
    """Whether the base leaves only the error of rounding and of the files' compression on these pairs."""
    objective, which = PixelObjective.of(pairs), list(which)
    z = np.zeros(len(base.model.coordinates))
    objective = objective.robust(objective.at(base.model, z))
    at = objective.at(base.model, z)
    floor = objective.floor_errors(at, objective.floor_difference(at, files))[which].mean()
    left = Gap(float(at.errors[which].mean()), float(floor), criteria.least_unit)
    return not left.exceeds(criteria.null_drop)


def fit_base(model: Model, pairs: Pairs, fit_on: Sequence[int]) -> Base:
    """Fit the base with the best demosaicker, or a mix of it with one of the next best.

    White balance may come before or after it, and it may act on linear values or on their square roots. A mix
    stands for a demosaicker that is not among these. It must lower the error clearly.
    """
    objective, own = PixelObjective.of(pairs).take(fit_on), model.take(fit_on)
    at = objective.at(own, np.zeros(len(model.coordinates)))
    at = fit(objective, at, model.base_indices, steps=6).point
    objective = objective.robust(at)
    found = choices(model)
    roots = [_on_roots(choice) for choice in found]

    def with_choice(choice: Variant) -> Point:
        return objective.at(own.chosen(choice.take(fit_on)), at.z)

    def error_of(choice: Variant) -> float:
        return with_choice(choice).error

    errors, of_roots = (parallel_map(error_of, some) for some in (found, roots))
    linear, root = found[int(np.argmin(errors))], roots[int(np.argmin(of_roots))]
    rooted_best = min(of_roots) < ROOTED * min(errors)
    best, rival = (root, linear) if rooted_best else (linear, None)
    at = fit(objective, with_choice(best), model.base_indices, steps=4).point
    ranked = [found[i] for i in np.argsort(errors)]
    mixes = _mixes(best, ranked)
    mixed = parallel_map(with_choice, mixes)
    least = int(np.argmin([m.error for m in mixed]))
    if mixed[least].error < _MIXED * at.error:
        best = mixes[least]
        at = fit(objective, mixed[least], model.base_indices, steps=2).point
    every = list(range(len(fit_on)))
    absorbed = absorbed_shares(objective, at.model.moved(at.z), model.shared, every)
    absorbed["demosaicking"] = 1 - min(errors) / max(errors)
    return Base(model.chosen(best).moved(at.z), absorbed, [*ranked[:_NEAREST], root, best], rival)


def choices(model: Model) -> list[Variant]:
    """All demosaickers, each before and after white balance."""
    first = model.per_pair["mosaic_white_balance"]
    orders = [(first, _neutral(first)), (_neutral(first), first)]
    return [
        Variant(
            {"demosaicking": Demosaicking(shares=shares)} | rooted(False),
            {"mosaic_white_balance": early, "later_balance": late},
        )
        for shares in np.eye(len(DEMOSAICKERS), dtype=np.float32)
        for early, late in orders
    ]


def _mixes(best: Variant, ranked: Sequence[Variant]) -> list[Variant]:
    """The best choice with shares of the next best algorithms in place of a part of its own."""
    own = np.asarray(best.shared["demosaicking"].shares)
    others = dict.fromkeys(int(np.argmax(c.shared["demosaicking"].shares)) for c in ranked)
    nearest = [k for k in others if not own[k]][:_PARTNERS]
    alone = np.eye(len(own), dtype=np.float32)

    def mixed(other: int, share: float) -> Variant:
        shares = np.float32((1 - share) * own + share * alone[other])
        return dataclasses.replace(best, shared=best.shared | {"demosaicking": Demosaicking(shares=shares)})

    return [mixed(k, share) for k in nearest for share in _SHARES]


def _on_roots(choice: Variant) -> Variant:
    return dataclasses.replace(choice, shared=choice.shared | rooted(True))


def _neutral(balance: WhiteBalance) -> WhiteBalance:
    return WhiteBalance(gains=np.ones_like(balance.gains))


def _start(raws: Sequence[Raw], pairs: Pairs, cfa: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Start of the fit of a base.

    Returns:
        gains (N, 3); a colour matrix (3, 3) by least squares; a typical matrix for scenes without colours,
        else None. A matrix fitted to the noise of grey scenes would imitate effects that reduce this noise,
        such as compression.
    """
    stated = stated_gains(raws)
    gains = np.ones((len(raws), 3)) if stated is None else stated
    light, linear = _balanced(pairs, cfa, gains), srgb_to_linear(pairs.pictures)
    grey = is_colourless(light, pairs.mask)

    def shade(pixels: np.ndarray) -> np.ndarray:
        return np.asarray(pixels[pairs.mask].mean(0))

    if stated is None:
        if grey:
            white = shade(light) / shade(linear)
        else:  # from the matrix
            white = np.linalg.solve(start_matrix(light, pairs.pictures, pairs.mask), np.ones(3))
        gains = np.clip(white[1] / white, 0.125, 8)[None].repeat(len(raws), 0)
        light = _balanced(pairs, cfa, gains)
    matrix = start_matrix(light, pairs.pictures, pairs.mask)
    if not grey:
        return gains, matrix, None
    return gains, matrix, typical_matrix(shade(linear) / (typical_matrix(np.ones(3)) @ shade(light)))


def _balanced(pairs: Pairs, cfa: str, gains: np.ndarray) -> np.ndarray:
    """White-balance the mosaics by gains (N, 3) and demosaick them: (N, H, W, 3) linear RGB."""
    rgb = []
    balanced, flat = (
        stage("mosaic_white_balance", cfa=cfa),
        stage(demosaicking, cfa=cfa, algorithm="bilinear"),
    )
    for mosaic, gain in zip(pairs.light, gains):
        own = run(balanced, {balanced.name: WhiteBalance(gains=np.asarray(gain, np.float32))}, mosaic)
        rgb.append(np.asarray(run(flat, flat.init(), own)))
    return np.stack(rgb)
