"""A network as one file: its weights, and what it is."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from jaxisp.errors import InputError, one_line
from jaxisp.io.files import atomic_write, open_input

_ABOUT = "about"
_KEPT = nnx.Any(nnx.Param, nnx.BatchStat)


def save_network(
    path: str | Path, network: nnx.Module, model: str, options: Mapping[str, Any], **about: Any
) -> None:
    """Write a network as an .npz file that `jaxisp.models.read_network` reads.

    Args:
        path: of the file, written whole or not at all.
        network: whose weights and running averages are kept.
        model: its name, one of `MODELS`.
        options: of its constructor.
        **about: what else is kept, as JSON has it.
    """
    text = json.dumps({"model": model, "options": dict(options), **about})
    with atomic_write(path) as file:
        arrays: dict[str, Any] = jax.tree.map(np.asarray, {**_named(network), _ABOUT: text})
        np.savez(file, **arrays)


def read_arrays(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Weights by name and what is kept with them. Raises InputError where the file is none of a network."""
    with open_input(path) as file:
        try:
            with np.load(file, allow_pickle=False) as found:
                arrays = dict(found)
            about = json.loads(str(arrays.pop(_ABOUT)))
        except Exception as error:  # an archive, headers and JSON: they fail in many ways
            raise InputError(f"{path}: holds no network ({one_line(error)})") from error
    if not isinstance(about, dict):
        raise InputError(f"{path}: holds no network")
    return arrays, about


def fill(network: nnx.Module, arrays: Mapping[str, np.ndarray], path: str | Path) -> None:
    """Give a network, or the shapes of one, the weights of that name each.

    Raises:
        InputError: they do not fit.
    """
    own = _named(network)
    for name in sorted({*own, *arrays}):
        if name not in arrays or name not in own or arrays[name].shape != own[name].shape:
            raise InputError(f"{path}: holds another network: {name} is not in both, or of another shape")
    state = nnx.state(network, _KEPT)
    values = jax.tree.map_with_path(
        lambda key, leaf: jnp.asarray(arrays[jax.tree_util.keystr(key)], leaf.dtype), nnx.to_pure_dict(state)
    )
    nnx.replace_by_pure_dict(state, values)
    nnx.update(network, state)


def _named(network: nnx.Module) -> dict[str, Any]:
    leaves = jax.tree.leaves_with_path(nnx.to_pure_dict(nnx.state(network, _KEPT)))
    return {jax.tree_util.keystr(key): leaf for key, leaf in leaves}
