"""Make docs/images/degraded.png: clean patches, white noise, and the phone, side by side.

    python -m experiments.readme_picture

The photographs come with scikit-image (public domain and CC0).
"""

from pathlib import Path

import jax
import numpy as np

from jaxisp.color import linear_to_srgb
from jaxisp.io import output_folder, write_png
from jaxisp.recipes import find_recipe
from jaxisp.samples import scene

PATCH, MAGNIFY, GAP = 96, 2, 6
PLACES = (("astronaut", (0.3, 0.45, 0.5)), ("coffee", (0.5, 0.5, 0.6)), ("chelsea", (0.3, 0.6, 0.6)))


def main() -> None:
    linear = np.stack([scene(name, PATCH, window) for name, window in PLACES])
    clean = linear_to_srgb(linear).astype(np.float32)
    rows = [clean]
    for name in ("awgn", "phone"):
        noisy, _, _ = find_recipe(name).degrade(jax.random.key(4), clean)
        rows.append(np.asarray(noisy))
    pad = [(GAP, GAP), (GAP, GAP), (0, 0)]
    framed = [np.concatenate([np.pad(big(p), pad, constant_values=1) for p in row], 1) for row in rows]
    write_png(output_folder(Path("docs/images")) / "degraded.png", np.concatenate(framed, 0))


def big(patch: np.ndarray) -> np.ndarray:
    return patch.repeat(MAGNIFY, 0).repeat(MAGNIFY, 1)


if __name__ == "__main__":
    main()
