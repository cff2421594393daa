"""Which parameters one camera shares, which each image has of its own, and which stay: a tree of flags."""

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.errors import InputError, meant
from jaxisp.params import bounds_to_line, line_to_bounds, map_specs, specs, to_bounded, to_unbounded
from jaxisp.pipeline import Params
from jaxisp.process.programs import QUICK

CAMERA, IMAGE, FIXED = "camera", "image", "fixed"
Limits = tuple[tuple[float, float, bool], ...]
"""Bounds of numbers, and whether each is on a logarithmic scale."""

FIXED_NAMES = (
    "exposure",  # the colour matrix holds the scale; see `canonical`
    "vignetting.a6",
    "geometric_distortion.k2",
    "denoise_encoding",
    "denoise_decoding",
    "unsharp_mask.threshold",
    "chroma_subsampling.sampled",
    "chroma_subsampling.repeated",
)
"""What stays where it starts, unless `free` or `per_image` asks for it."""

GROUPS = {
    "tone": ("gamma_compression", "s_curve", "zone_curve"),
    "colour": ("color_matrix", "saturation"),
}
"""Names that stand for several stages."""


def sharing(
    params: Params, per_image: Iterable[str] = (), fixed: Iterable[str] = (), free: Iterable[str] = ()
) -> Params:
    """The flags of a parameter tree: a tree of the same shape whose leaves are "camera", "image" or "fixed".

    Names are stages, `stage.field`s or groups ("tone", "colour").

    Args:
        params: the parameters.
        per_image: what each image has of its own.
        fixed: what is not fitted (`freeze` of a fit), beside `FIXED_NAMES`; what is per image is.
        free: of `FIXED_NAMES`, what is fitted all the same.

    Raises:
        InputError: no such stage or field, or one that is both fixed and to be fitted.
    """
    flags = map_specs(lambda spec, _: CAMERA, params)
    own, held, freed = (_expanded(names, params) for names in (per_image, fixed, free))
    both = sorted(".".join(name) for name in held & (own | freed))
    if both:
        raise InputError(f"frozen, and free or per image at once: {', '.join(both)}")
    kept = (_expanded(FIXED_NAMES, params) - freed | held) - own
    for flag, names in ((FIXED, kept), (IMAGE, own)):
        for stage, field in names:
            flags[stage] = dataclasses.replace(flags[stage], **{field: flag})
    return flags


def _expanded(names: Iterable[str], params: Params) -> set[tuple[str, str]]:
    fields = {stage: list(specs(type(values))) for stage, values in params.items()}
    known = [*GROUPS, *fields, *(f"{stage}.{field}" for stage, own in fields.items() for field in own)]
    found = set()
    for name in names:
        if name not in known:
            among = meant(str(name), known) or f"; there are {', '.join([*GROUPS, *fields])}"
            raise InputError(f"no fitted parameter is named {name!r}{among}")
        for part in GROUPS.get(name, (name,)):
            stage, _, field = part.partition(".")
            found |= {(stage, f) for f in ([field] if field else fields[stage])}
    return found


@dataclasses.dataclass(frozen=True)
class Layout:
    """How the fitted leaves lie in two vectors, the camera's and an image's. Hashable: a static argument.

    Args:
        leaves: (stage, field, flag, shape) of all leaves, in order.
    """

    leaves: tuple[tuple[str, str, str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, params: Params, flags: Params) -> "Layout":
        return cls(
            tuple(
                (stage, field, getattr(flags[stage], field), np.shape(getattr(values, field)))
                for stage, values in params.items()
                for field in specs(type(values))
            )
        )

    @functools.cached_property
    def names(self) -> dict[str, tuple[tuple[str, str], ...]]:
        """By flag: (stage, field[index]) of each element of the vector."""
        return {
            flag: tuple(
                (stage, field + (f"[{', '.join(map(str, index))}]" if shape else ""))
                for stage, field, own, shape in self.leaves
                if own == flag
                for index in np.ndindex(shape)
            )
            for flag in (CAMERA, IMAGE, FIXED)
        }

    def size(self, flag: str) -> int:
        return len(self.names[flag])

    def vector(self, params: Params, flag: str) -> np.ndarray:
        """The leaves of that flag on the real line, in a row."""
        parts = [np.ravel(getattr(params[s], f)) for s, f, own, _ in self.leaves if own == flag]
        values = np.concatenate([np.zeros(0, np.float32), *parts]).astype(np.float32)
        return np.asarray(_unbounded(values, self._limits(params, flag)), np.float64)

    def params(self, fixed: Params, camera: Any, image: Any) -> Params:
        """Bounded parameters out of the two vectors; what is fixed is taken from `fixed`. May be traced."""
        fields: dict[str, dict[str, Any]] = {stage: {} for stage in fixed}
        for flag, vector in ((CAMERA, camera), (IMAGE, image)):
            # all of one vector at once: one by one, each is a program's step of its own
            values = line_to_bounds(jnp.asarray(vector), *_columns(self._limits(fixed, flag)))
            at = 0
            for stage, field, own, shape in self.leaves:
                if own == flag:
                    count = int(np.prod(shape))
                    fields[stage][field] = jnp.reshape(values[at : at + count], shape)
                    at += count
        return {stage: dataclasses.replace(fixed[stage], **moved) for stage, moved in fields.items()}

    def _limits(self, params: Params, flag: str) -> Limits:
        """Of each element of the vector of that flag."""
        found: list[tuple[float, float, bool]] = []
        for stage, field, own, shape in self.leaves:
            if own == flag:
                spec = specs(type(params[stage]))[field]
                found += [(*spec.bounds, spec.scale == "log")] * int(np.prod(shape))
        return tuple(found)

    def bounded(self, fixed: Params, camera: Any, image: Any) -> Params:
        """The same of arrays, by a program: operation by operation, each would be compiled for each shape."""
        return as_arrays(_bounded(self, fixed, camera, image))


def _columns(limits: Limits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    low, high, log = np.reshape(np.asarray(limits, np.float64), (-1, 3)).T
    return low, high, log > 0


@functools.partial(jax.jit, static_argnums=1, compiler_options=QUICK)
def _unbounded(values: jax.Array, limits: Limits) -> jax.Array:
    return bounds_to_line(values, *_columns(limits))


_bounded = jax.jit(Layout.params, static_argnums=0, compiler_options=QUICK)


def mean_of(values: Sequence[Params]) -> Params:
    """The mean of several parameter trees, on the scale each parameter varies on."""
    free = [to_unbounded(v) for v in values]
    means = map_specs(lambda spec, *leaves: jnp.mean(jnp.stack(leaves), axis=0), free[0], *free[1:])
    return as_arrays(to_bounded(means))


def canonical(params: Params) -> Params:
    """The same camera with the scale of the colour matrix moved into the exposure.

    Exposure and matrix multiply: only their product shows. In the camera's file white keeps its
    luminance in the matrix, so that the exposure says how bright the camera renders.
    """
    matrix = np.asarray(params["color_matrix"].matrix, np.float64)
    gain = float(np.clip(matrix.sum(axis=1).mean(), 2.0**-6, 2.0**6))
    ev = float(params["exposure"].exposure_ev) + np.log2(gain)
    scaled = (matrix / gain).astype(np.float32)
    low, high = specs(type(params["color_matrix"]))["matrix"].bounds
    if not -8 <= ev <= 8 or scaled.min() < low or scaled.max() > high:
        return params
    exposure, color = params["exposure"], params["color_matrix"]
    return params | {
        "exposure": dataclasses.replace(exposure, exposure_ev=np.float32(ev)),
        "color_matrix": dataclasses.replace(color, matrix=scaled),
    }


def as_arrays(params: Params) -> Params:
    """The same parameters as float32 arrays: Python numbers would be compiled for anew."""
    return {
        stage: type(values)(**{f: np.asarray(getattr(values, f), np.float32) for f in specs(type(values))})
        for stage, values in params.items()
    }
