"""Distances, and masks of the pixels that count."""

import jax
import jax.numpy as jnp

__all__ = ["border_mask", "charbonnier", "clip_mask", "log_rms"]
__dir__ = __all__.copy  # what an editor completes


def charbonnier(x: jax.Array, epsilon: float | jax.Array = 1e-3) -> jax.Array:
    """`sqrt(x**2 + epsilon**2) - epsilon`: quadratic near 0, `abs(x)` beyond `epsilon`, a positive number.

    Gradient: exact, bounded by 1.

    Source: Charbonnier, Blanc-Feraud, Aubert & Barlaud 1994.

    Example:
        >>> import numpy as np
        >>> round(float(charbonnier(np.float32(3.0))), 2)
        3.0
    """
    return x**2 / (jnp.sqrt(x**2 + epsilon**2) + epsilon)  # the same, without cancellation near 0


def log_rms(x: jax.Array, floor: float = 1e-3) -> jax.Array:
    """(N,) natural logarithms of the root mean squares of (N, ...) differences, softly above `floor`.

    Its mean over a batch is the mean PSNR but for sign, factor and the floor: 0.115 is 1 dB. The floor keeps
    the gradient finite where there is no difference.

    Source: the PSNR loss of Chen, Chu, Zhang & Sun 2022 (NAFNet), in other units.

    Example:
        >>> import numpy as np
        >>> round(float(log_rms(np.full((1, 4, 4, 3), 0.1), 0.0)[0]), 3)
        -2.303
    """
    return 0.5 * jnp.log((x**2).mean(axis=tuple(range(1, x.ndim))) + floor**2)


def border_mask(shape: tuple[int, ...], border: int) -> jax.Array:
    """(H, W) boolean for an image of that shape: False within `border` px of an edge, True inside.

    Example:
        >>> int(border_mask((8, 6), 2).sum())
        8
    """
    h, w = shape[:2]
    rows = jax.lax.broadcasted_iota(jnp.int32, (h, w), 0)
    columns = jax.lax.broadcasted_iota(jnp.int32, (h, w), 1)
    return (jnp.minimum(rows, h - 1 - rows) >= border) & (jnp.minimum(columns, w - 1 - columns) >= border)


def clip_mask(image: jax.Array, low: float = 1 / 255, high: float = 254 / 255) -> jax.Array:
    """(H, W) boolean: True where every channel of (H, W, 3), or the (H, W) plane, is in [low, high].

    A clipped pixel says only that the scene was darker or brighter: it must not pull on the fit.

    Example:
        >>> import numpy as np
        >>> clip_mask(np.asarray([[0.0, 0.5, 1.0]])).tolist()
        [[False, True, False]]
    """
    inside = (image >= low) & (image <= high)
    return inside.all(axis=-1) if image.ndim == 3 else inside
