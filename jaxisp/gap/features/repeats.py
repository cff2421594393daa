"""Statistics of the residual that repeats from scene to scene."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.barriers import materialize
from jaxisp.gap.features.mean import CHANNELS, Found, blurred_planes, named
from jaxisp.gap.features.quantization import averages

_PLAIN, _PLAINLY = 0.05, 0.2  # correlations between scenes that exceed chance, for pixels and for spots
_FEW = 2.5  # standard deviations of noise at which pixels are clipped before spots are measured


def pattern_part(r: jax.Array, s: jax.Array, mask: jax.Array, others: jax.Array) -> Found:
    """Correlations of each pair's residual with the residuals of other scenes, by pixel and by line.

    Args:
        r: (N, h, w, 3) residuals, Y'CbCr in 8-bit steps.
        s: (N, h, w, 3) noise-free pictures, likewise.
        mask: (N, h, w) weight of each pixel.
        others: (N, N) averaging matrix over other scenes, see `residual_statistics.Frames`.

    Returns:
        values (N, K) by their names.
    """
    r, light = materialize(jnp.moveaxis(r * mask[..., None], -1, 1)), s[:, None, ..., 0]
    fine, spots = materialize(jax.lax.map(_fine_and_spots, r))
    luma = fine[:, :1]
    bright = materialize(jnp.concatenate([luma * light / 255, jnp.maximum(jnp.abs(luma) - 3, 0)], 1))
    found: Found = {
        named("pattern fixed_pattern {} pixel", CHANNELS): _repeated(fine, others),
        named("coarse fixed_pattern {}", CHANNELS): _repeated(spots, others, _PLAINLY),
        ("pattern fixed_pattern bright", "pattern tail peaks"): _repeated(bright, others),
    }
    for axis, of in ((-2, "column"), (-1, "row")):
        line = r.sum(axis) / (mask.sum(axis) + 1e-3)[:, None]
        step = line[..., 1:-1] - 0.5 * (line[..., :-2] + line[..., 2:])
        found[named(f"pattern {of} {{}} repeats", CHANNELS)] = _repeated(step, others)
    return found


def _fine_and_spots(r: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split a residual (C, h, w) into pixel detail [standard deviations] and spots of 5 to 20 px [steps]."""
    high = materialize(r - blurred_planes(r, 1.5))
    size = jnp.sqrt(averages(high**2, jnp.ones((1, *high.shape[1:]), high.dtype)))[0, :, None, None]
    even = materialize(jnp.clip(r, -_FEW * size - 0.1, _FEW * size + 0.1))  # hot pixels must not form spots
    return jnp.clip(high / (size + 0.1), -4, 4), blurred_planes(even, 2.0) - blurred_planes(even, 8.0)


def _repeated(values: jax.Array, which: jax.Array, plain: float = _PLAIN) -> jax.Array:
    """Correlation (N, C) of values (N, C, h, w) with the mean of the other scenes, compressed above `plain`.

    Above `plain` it grows as a logarithm: whether a pattern repeats matters more than its contrast. The
    contrast depends on the scene's light and noise at few pixels.
    """
    flat = materialize(values.reshape(*values.shape[:2], -1).swapaxes(0, 1))  # four times as fast
    products = jnp.einsum("cnp,cmp->cnm", flat, flat, precision="highest")
    both = jnp.einsum("cnm,nm->nc", products, which, precision="highest")
    theirs = jnp.einsum("nm,cmk,nk->nc", which, products, which, precision="highest")
    found = both / (jnp.sqrt(jnp.einsum("cnn->nc", products) * theirs) + 1e-6)
    return plain * jnp.arcsinh(found / plain)
