"""What a fitter minimises: robust distances between images, and masks of the pixels that count."""

import jax
import jax.numpy as jnp

from jaxisp.arrays.planes import planes
from jaxisp.arrays.safe_math import safe_divide
from jaxisp.color import rgb_to_ycbcr_planes


def charbonnier(x: jax.Array, epsilon: float | jax.Array = 1e-3) -> jax.Array:
    """`sqrt(x**2 + epsilon**2) - epsilon`: quadratic near 0, |x| beyond `epsilon`, which must be positive.

    Gradient: exact, bounded by 1.

    Source: Charbonnier, Blanc-Feraud, Aubert & Barlaud 1994.
    """
    return x**2 / (jnp.sqrt(x**2 + epsilon**2) + epsilon)  # the same, without cancellation near 0


def luma_chroma_loss(
    a: jax.Array,
    b: jax.Array,
    mask: jax.Array | None = None,
    chroma_weight: float | jax.Array = 0.5,
    epsilon: float | jax.Array = 1e-3,
) -> jax.Array:
    """Mean Charbonnier distance of luma, plus `chroma_weight` times that of the two chroma planes.

    Args:
        a: (H, W, 3), display-encoded.
        b: like `a`.
        mask: (H, W), the weight of each pixel (or True where it counts); all of them if None.
        chroma_weight: what an error of chroma counts against one of luma.
        epsilon: below this difference the distance is quadratic.

    Returns:
        A scalar; 0 where no pixel counts.

    Raises:
        ValueError: not two (H, W, 3) images of one shape.

    Gradient: exact.
    """
    if a.shape != b.shape or a.ndim != 3 or a.shape[-1] != 3:
        raise ValueError(f"luma_chroma_loss: expected two (H, W, 3) images, got {a.shape} and {b.shape}")
    y, cb, cr = (charbonnier(d, epsilon) for d in rgb_to_ycbcr_planes(*planes(a - b)))
    distance = y + chroma_weight * (cb + cr)
    if mask is None:
        return distance.mean()
    weight = mask.astype(distance.dtype)
    return safe_divide((weight * distance).sum(), weight.sum())


def border_mask(shape: tuple[int, ...], border: int) -> jax.Array:
    """(H, W) boolean for an image of that shape: False within `border` px of an edge, True inside."""
    h, w = shape[:2]
    rows = jax.lax.broadcasted_iota(jnp.int32, (h, w), 0)
    columns = jax.lax.broadcasted_iota(jnp.int32, (h, w), 1)
    return (jnp.minimum(rows, h - 1 - rows) >= border) & (jnp.minimum(columns, w - 1 - columns) >= border)


def clip_mask(image: jax.Array, low: float = 1 / 255, high: float = 254 / 255) -> jax.Array:
    """(H, W) boolean: True where every channel of (H, W, 3), or the (H, W) plane, is in [low, high].

    A clipped pixel says only that the scene was darker or brighter: it must not pull on the fit.
    """
    inside = (image >= low) & (image <= high)
    return inside.all(axis=-1) if image.ndim == 3 else inside
