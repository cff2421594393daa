"""What the page shows of the pictures."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxisp.gap.case import Case
from jaxisp.gap.features.residual_statistics import frames_of, noise_of
from jaxisp.gap.features.spectra import Spread, spreads
from jaxisp.gap.pairs.pairs import to_steps
from jaxisp.gap.pairs.scenes import scene_name
from jaxisp.gap.simulator.effects import RAW_JPEG


def held_out_spreads(case: Case, picture: np.ndarray) -> dict[str, dict[str, Spread]]:
    """By whose it is, over the held-out pairs: "simulator" where the problem stands, and beside it "floor",
    what the file's own compression leaves (where that is known), or "real", the noise of the real pictures.

    Args:
        case: what is diagnosed.
        picture: (N, h, w, 3) what the problem simulates, Y'CbCr in 8-bit steps, its border cut off.
    """
    problem, held = case.problem, list(case.split.held_out)
    weight = problem.weight[held][..., 0]
    if case.kind == RAW_JPEG:
        left = {"simulator": problem.target - picture, "floor": case.stored}
        return {whose: spreads(own[held], weight) for whose, own in left.items() if own is not None}
    frames = frames_of([scene_name(problem.pairs.names[i]) for i in held])
    counted = jnp.asarray(weight > 0, jnp.float32)
    looked_at = {"simulator": (picture, problem.again), "real": (problem.target, problem.reference)}
    found = {}
    for whose, (pictures, against) in looked_at.items():
        own, shown = against.take(held), jnp.asarray(pictures[held])
        noise = noise_of(shown, own.picture, counted, own.maps, frames)
        found[whose] = spreads(np.asarray(noise), weight)
    return found


def example(case: Case, when: str) -> dict[str, Any]:
    """One held-out pair as the simulator makes it where the problem stands, what it lacks, and how that is
    spread in all of them."""
    problem, i = case.problem, case.split.held_out[0]
    whole = problem.rendered(problem.z)
    picture = to_steps(whole[problem.inner])
    spreads = held_out_spreads(case, picture)
    return {
        "name": problem.pairs.names[i],
        "target": problem.pairs.pictures[i],
        when: whole[i],
        f"residual_{when}": problem.target[i] - picture[i],
        f"spread_{when}": spreads.pop("simulator"),
        **{f"spread_{whose}": own for whose, own in spreads.items()},
    }
