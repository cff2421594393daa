"""Pictures of a page: a held-out pair before and after, and where in it the difference is."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from jaxisp.gap.report.plots import (
    CELL,
    data_uri,
    difference_picture,
    gain_for,
    heat,
    heat_picture,
    heat_scale,
)
from jaxisp.gap.report.words import number, words

_WHEN = ("before", "after")


def side_by_side(pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    """The camera's picture, the simulator's before and after, and below each what differs."""
    shown = [(1, "the camera's", pictures.get("target")), (2, "simulator, before", pictures.get("before"))]
    shown.append((3, "simulator, after", pictures.get("after")))
    differences = {w: pictures[f"residual_{w}"] for w in _WHEN if pictures.get(f"residual_{w}") is not None}
    candidate = pictures.get("candidate")
    gain = gain_for([*differences.values(), *([] if candidate is None else [candidate["changes"]])])
    if candidate is not None:
        caption = f"what {words(candidate['effect'])} changes, \N{MULTIPLICATION SIGN}{gain} about grey"
        shown.append((1, caption, difference_picture(candidate["changes"], gain)))
    for when, residual in differences.items():
        caption = f"difference {when}, \N{MULTIPLICATION SIGN}{gain} about grey"
        shown.append(
            (2 + _WHEN.index(when), caption, difference_picture(residual, gain))
        )  # below its picture
    figures = [{"column": c, "caption": text, "uri": data_uri(a)} for c, text, a in shown if a is not None]
    return {"name": str(pictures.get("name", "")), "figures": figures} if figures else None


def heat_figures(pictures: Mapping[str, Any]) -> dict[str, Any] | None:
    """Where in the held-out picture the difference is, before and after, on one scale."""
    maps = {w: heat(pictures[f"residual_{w}"]) for w in _WHEN if pictures.get(f"residual_{w}") is not None}
    if not maps:
        return None
    top = max(float(np.percentile(values, 99)) for values in maps.values())
    shown = [("the camera's picture", pictures.get("target"))]
    for when, values in maps.items():
        whole = number(float(np.sqrt((values**2).mean())))
        shown.append((f"difference {when}, {whole} over all", heat_picture(values, top)))
    figures = [{"caption": text, "uri": data_uri(a)} for text, a in shown if a is not None]
    told = {"name": str(pictures.get("name", "")), "top": number(top), "cell": CELL}
    return told | {"figures": figures, "scale": Markup(heat_scale())}
