"""For notebooks: pictures in a row, and sliders made from parameter specs whose picture follows at once."""

import base64
import functools
import io
import time
from collections.abc import Iterable
from html import escape
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image

from jaxisp.cfa import masks
from jaxisp.checks import check_scale
from jaxisp.domains import (
    ANY,
    ANY_RGB,
    CAMERA,
    ENCODED,
    ENCODED_PROPHOTO,
    LINEAR,
    MOSAIC,
    PROPHOTO,
    XYZ_D65,
    YCC,
    Domain,
)
from jaxisp.node import Node, Params, require_node, stage
from jaxisp.params import Spec, specs
from jaxisp.stages import STAGES
from jaxisp.stages.sensor import mosaic
from jaxisp.stages.spaces import (
    linear_srgb_to_prophoto,
    linear_srgb_to_xyz,
    prophoto_to_linear_srgb,
    rgb_to_ycbcr,
    xyz_to_linear_srgb,
    ycbcr_to_rgb,
)
from jaxisp.stages.transfer import prophoto_eotf, prophoto_oetf, srgb_eotf, srgb_oetf

__all__ = ["Explorer", "Pictures", "explore_stages", "for_screen", "in_domain", "picture_after"]
__dir__ = __all__.copy  # what an editor completes

MOST = 18
"""Parameters with more numbers than this get no sliders."""


class Pictures:
    """Pictures in a row with captions, as a notebook shows them.

    Args:
        pictures: (caption, picture): (H, W, 3) or (H, W), encoded, in [0, 1] or in whole levels (uint8).
        magnify: how often each pixel is repeated; nothing is smoothed.
    """

    def __init__(self, pictures: Iterable[tuple[str, Any]], *, magnify: int = 1) -> None:
        self.figures = [(str(caption), np.asarray(picture)) for caption, picture in pictures]
        self.magnify = magnify

    def __repr__(self) -> str:
        return f"Pictures({', '.join(caption for caption, _ in self.figures)})"

    def _repr_html_(self) -> str:
        return (
            f'<div style="display:flex;flex-wrap:wrap;gap:12px">{"".join(map(self._one, self.figures))}</div>'
        )

    def _one(self, figure: tuple[str, np.ndarray]) -> str:
        caption, picture = figure
        larger = picture.repeat(self.magnify, axis=0).repeat(self.magnify, axis=1)
        encoded = base64.b64encode(_png(larger)).decode()
        return (
            f'<figure style="margin:0;width:{larger.shape[1]}px;max-width:100%"><img alt="{escape(caption)}"'
            f' src="data:image/png;base64,{encoded}" style="max-width:100%;display:block">'
            f'<figcaption style="font-size:small">{escape(caption)}</figcaption></figure>'
        )


def in_domain(picture: Any, domain: Domain, cfa: str = "RGGB") -> jax.Array:
    """A photograph as a stage of that domain wants it.

    Args:
        picture: (H, W, 3) encoded sRGB, in [0, 1] or in whole levels (uint8).
        domain: the stage's. Where anything will do, noise (any image) gets linear light, and what takes
            any three channels the picture as it is.
        cfa: of a mosaic.
    """
    encoded = _shares(jnp.asarray(picture))
    check_scale(
        "the explorer", ENCODED, encoded if isinstance(encoded, jax.core.Tracer) else np.asarray(encoded)
    )
    light = srgb_eotf(encoded)
    if domain == MOSAIC:
        return mosaic(light, cfa=cfa)
    if domain in (PROPHOTO, ENCODED_PROPHOTO):
        wide = linear_srgb_to_prophoto(light)
        return wide if domain == PROPHOTO else prophoto_oetf(wide)
    if domain == XYZ_D65:
        return linear_srgb_to_xyz(light)
    if domain == YCC:
        return rgb_to_ycbcr(encoded)
    return light if domain in (LINEAR, CAMERA, ANY) else encoded


def for_screen(image: jax.Array, domain: Domain, cfa: str = "RGGB") -> jax.Array:
    """An image of a domain as (H, W, 3) encoded sRGB in [0, 1]; a mosaic has each photosite in its colour."""
    if domain == MOSAIC or image.ndim == 2:
        shape = image.shape[0], image.shape[1]
        image = jnp.stack([jnp.where(mask, image, 0) for mask in masks(shape, cfa)], -1)
    elif domain in (PROPHOTO, ENCODED_PROPHOTO):
        image = prophoto_to_linear_srgb(image if domain == PROPHOTO else prophoto_eotf(image))
    elif domain == XYZ_D65:
        image = xyz_to_linear_srgb(image)
    elif domain == YCC:
        image = ycbcr_to_rgb(image)
    encoded = domain in (ENCODED, ANY_RGB, YCC)
    return jnp.clip(image if encoded else srgb_oetf(image), 0, 1)


class Explorer:
    """Sliders for each parameter of a stage or a chain, and the picture that it makes.

    Ranges, scales and units come from the parameters' specs. The pipeline is compiled once; a slider that
    moves only runs it. In a notebook an explorer at the end of a cell shows itself.

    Args:
        node: a stage, a chain, a gate or a shuffle.
        picture: (H, W, 3) encoded sRGB in [0, 1]; it is brought into the pipeline's domain.
        params: where the sliders start; the defaults unless given.
        cfa: of the mosaic, where there is one.
        width: of the picture on the screen [px].
    """

    def __init__(
        self, node: Node, picture: Any, *, params: Params | None = None, cfa: str = "RGGB", width: int = 420
    ) -> None:
        require_node(node, "Explorer")
        widgets = _widgets()
        self.node, self.cfa = node, cfa
        self.params: Params = dict(node.init() if params is None else params)
        self.key = jax.random.key(0)
        self._given = in_domain(picture, node.domain_in, cfa)
        self.picture = widgets.Image(format="png", layout=widgets.Layout(width=f"{width}px"))
        self.status = widgets.Label()
        self.sliders: dict[str, Any] = {}
        controls = [row for name in self.params for row in self._controls(name)]
        if node.stochastic:
            seed = widgets.IntSlider(0, 0, 99, description="seed")
            seed.observe(self._reseed, "value")
            self.sliders["seed"] = seed
            controls.append(seed)
        panel = widgets.VBox(controls, layout=widgets.Layout(max_height="32em", overflow="auto"))
        self.widget = widgets.HBox([widgets.VBox([self.picture, self.status]), panel])
        self.draw()

    def _controls(self, name: str) -> list[Any]:
        widgets, rows = _widgets(), [_widgets().HTML(f"<b>{escape(name)}</b>")]
        for field, spec in specs(type(self.params[name])).items():
            value = np.asarray(getattr(self.params[name], field), np.float32)
            if value.size > MOST:
                rows.append(widgets.Label(f"{field}: {value.size} numbers, not shown"))
                continue
            for index in np.ndindex(value.shape):
                path = f"{name}.{field}" + "".join(f"[{i}]" for i in index)
                slider = _slider(spec, float(value[index]), path.removeprefix(f"{name}."))
                slider.observe(functools.partial(self._moved, name, field, index, spec), "value")
                self.sliders[path] = slider
                rows.append(slider)
        return rows

    def _moved(self, name: str, field: str, index: tuple[int, ...], spec: Spec, change: Any) -> None:
        own = self.params[name]
        value = np.array(getattr(own, field), np.float32)
        value[index] = np.clip(change["new"], *spec.bounds)  # 10**x may step over a bound
        self.params[name] = type(own)(**{**vars(own), field: value})
        self.draw()

    def _reseed(self, change: Any) -> None:
        self.key = jax.random.key(change["new"])
        self.draw()

    def draw(self) -> None:
        """Run the pipeline with the parameters as they are, and show what comes out."""
        clock = time.perf_counter()
        picture = np.asarray(_shown(self.node, self.cfa, self.params, self._given, self.key))
        self.picture.value = _png(picture)
        height, width = picture.shape[:2]
        self.status.value = f"{width}x{height}, {1e3 * (time.perf_counter() - clock):.0f} ms"

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.widget._repr_mimebundle_(**options)


def explore_stages(picture: Any, *, first: str = "unsharp_mask", width: int = 420) -> Any:
    """An explorer with a list of all registered stages to choose from; a widget."""
    widgets = _widgets()
    choice = widgets.Dropdown(options=sorted(STAGES), value=first, description="stage")
    place = widgets.VBox()

    def show(change: Any) -> None:
        place.children = (Explorer(stage(choice.value), picture, width=width).widget,)

    choice.observe(show, "value")
    show(None)
    return widgets.VBox([choice, place])


def picture_after(
    node: Node, picture: Any, params: Params | None = None, *, seed: int = 0, cfa: str = "RGGB"
) -> np.ndarray:
    """What a stage or chain makes of a photograph, as the screen shows it.

    Args:
        node: a stage, a chain, a gate or a shuffle.
        picture: (H, W, 3) encoded sRGB in [0, 1]; it is brought into the pipeline's domain.
        params: the defaults unless given.
        seed: of the noise.
        cfa: of the mosaic, where there is one.

    Returns:
        (H, W, 3) float32 encoded sRGB in [0, 1].
    """
    require_node(node, "picture_after")
    given = in_domain(picture, node.domain_in, cfa)
    return np.asarray(
        _shown(node, cfa, node.init() if params is None else params, given, jax.random.key(seed))
    )


@functools.partial(jax.jit, static_argnums=(0, 1))
def _shown(node: Node, cfa: str, params: Params, image: jax.Array, key: jax.Array) -> jax.Array:
    domain = node.domain_out
    if domain.keeps:  # it gives what it was given
        domain = _taken(node.domain_in)
    return for_screen(node(params, image, key=key), domain, cfa)


def _taken(domain: Domain) -> Domain:
    """The domain that `in_domain` gives."""
    return {ANY: LINEAR, ANY_RGB: ENCODED}.get(domain, domain)


def _slider(spec: Spec, value: float, label: str) -> Any:
    """On the spec's scale, from bound to bound, in 100 to 200 steps."""
    widgets, (low, high) = _widgets(), spec.bounds
    text = label if spec.unit == "1" else f"{label} [{spec.unit}]"
    shared = {
        "description": text,
        "tooltip": spec.doc,
        "style": {"description_width": "12em"},
        "layout": widgets.Layout(width="28em"),
        "readout_format": ".3g",
    }
    if spec.scale == "log":
        ends = np.log10(low), np.log10(high)
        return widgets.FloatLogSlider(
            value, min=ends[0], max=ends[1], step=(ends[1] - ends[0]) / 200, **shared
        )
    step = 10 ** np.floor(np.log10((high - low) / 100))
    return widgets.FloatSlider(value, min=low, max=high, step=step, **shared)


def _shares(picture: Any) -> Any:
    """A picture in float32; whole levels become shares of the largest."""
    largest = np.iinfo(picture.dtype).max if np.issubdtype(picture.dtype, np.unsignedinteger) else 1
    return picture.astype(np.float32) / largest


def _png(picture: np.ndarray) -> bytes:
    levels = np.round(255 * np.clip(_shares(picture), 0, 1)).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _widgets() -> Any:
    try:
        import ipywidgets
    except ImportError:
        raise ImportError("the explorer needs ipywidgets: pip install 'jaxisp[notebooks]'") from None
    return ipywidgets
