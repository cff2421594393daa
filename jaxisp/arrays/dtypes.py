"""The dtype that a stage computes in, which is its image's or, where that has half precision, float32."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax


def given_and_exact(image: Any) -> tuple[Any, Any]:
    """An image's dtype, and the one to compute in: 8 to 11 bits hold neither a sum nor a raw level."""
    dtype = jnp.result_type(image)
    # not `promote_types`, which strict promotion refuses
    return dtype, dtype if jnp.finfo(dtype).bits >= 32 else jnp.dtype(jnp.float32)


def in_dtype(tree: Any, dtype: Any) -> Any:
    """`tree` with its arrays and Python numbers in a dtype."""

    def cast(leaf: Any) -> Any:
        if isinstance(leaf, int | float):
            return jnp.asarray(leaf, dtype)  # stages use methods of arrays
        fits = not hasattr(leaf, "dtype") or jnp.result_type(leaf) == dtype
        return leaf if fits else lax.convert_element_type(leaf, dtype)

    return jax.tree.map(cast, tree)
