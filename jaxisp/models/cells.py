"""Statistics of cells of a picture that tell its noise from its texture, and its camera from others."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.color import LUMA_601
from jaxisp.jpeg.blocks import dct_matrix

CELL = 16
"""Pixels of a side of a cell."""
LEAST = 0.5 / 255
"""Noise below which no level is told from another."""
_DCT, _STRIDE = 8, 4  # as in JPEG files, whose blocks every other one of these meets
REACH = _DCT - _STRIDE
"""Pixels beyond a cell that its statistics depend on."""
OPPONENT = (LUMA_601, (-0.5, 0.5, 0.0), (-0.25, -0.25, 0.5))
"""Luma and two differences of colour, which are brought to length 1: white noise is as strong in all."""


def told_levels(levels: jax.Array) -> jax.Array:
    """Standard deviations as networks are told them: their logarithm, 0 where there is no noise."""
    return jnp.log2(1 + levels / LEAST) / 4


STATISTICS = 4 * len(OPPONENT) * 2 * (_DCT - 1) + 6
"""How many there are of a cell."""


def _bands() -> np.ndarray:
    """(64, 14) weights: the mean of the DCT's coefficients of a largest frequency, those along rows and those
    along columns apart."""
    v, u = np.divmod(np.arange(_DCT**2), _DCT)
    largest = np.maximum(u, v)
    bands = np.stack([(largest == f) & ((v < u) == rows) for f in range(1, _DCT) for rows in (0, 1)], -1)
    return bands / bands.sum(0)


def cell_statistics(x: jax.Array) -> jax.Array:
    """Statistics of each cell, about 0, through which no gradient goes.

    Of the energies of its cosine transforms in bands, in luma and two colours, the mean, the mean of the
    logarithms, the least and a low quantile: noise fills all blocks, most texture does not. Then its mean
    and its largest values.

    Args:
        x: (N, H, W, 3) encoded pictures; sizes are multiples of 16.

    Returns:
        (N, H / 16, W / 16, STATISTICS).
    """
    n, h, w, _ = x.shape
    rows, columns = h // CELL, w // CELL
    mix = np.asarray(OPPONENT) / np.linalg.norm(OPPONENT, axis=1, keepdims=True)
    y = jnp.einsum("nhwc,dc->ndhw", x.astype(jnp.float32), mix.astype(np.float32), precision="highest")
    y = y.reshape(-1, h, w, 1)
    y = jnp.pad(y, ((0, 0), (0, REACH), (0, REACH), (0, 0)), mode="edge")
    waves = np.einsum("vy,ux->yxvu", dct_matrix(), dct_matrix()).reshape(_DCT, _DCT, 1, -1)
    layout = ("NHWC", "HWIO", "NHWC")
    coefficients = jax.lax.conv_general_dilated(
        y,
        waves.astype(np.float32),
        (_STRIDE, _STRIDE),
        "VALID",
        dimension_numbers=layout,
        precision="highest",
    )
    energies = jnp.matmul(coefficients**2, _bands().astype(np.float32), precision="highest")
    side = CELL // _STRIDE
    blocks = energies.reshape(n, len(mix), rows, side, columns, side, -1)
    blocks = blocks.transpose(0, 2, 4, 3, 5, 1, 6).reshape(n, rows, columns, side**2, -1)
    blocks = jnp.sort(blocks, 3)
    told = told_levels(jnp.sqrt(blocks))
    kinds = [told_levels(jnp.sqrt(blocks.mean(3))), told.mean(3), told[..., 0, :], told[..., side**2 // 4, :]]
    pixels = x.reshape(n, rows, CELL, columns, CELL, 3)
    about = [2 * (kind - 0.6) for kind in kinds]
    about += [2 * pixels.mean((2, 4)) - 1, 2 * pixels.max((2, 4)) - 1]
    return jax.lax.stop_gradient(jnp.concatenate(about, -1))
