"""Pipelines, recipes, results and data as they show themselves: a few lines of text, or a table of HTML."""

import dataclasses
import html
import textwrap
from collections.abc import Iterable, Iterator, Sequence, Sized
from pathlib import PurePath
from typing import Any

import jax
import numpy as np

from jaxisp.params import specs

WIDTH = 100
"""Columns of the text."""
_MOST = 6  # numbers of an array that are shown one by one


def value_text(value: Any) -> str:
    """A parameter's value: a number, a distribution, or what there is to say of an array."""
    if isinstance(value, jax.core.Tracer):
        return f"traced{list(value.shape)}"
    if dataclasses.is_dataclass(value):  # a distribution
        given = [getattr(value, field.name) for field in dataclasses.fields(value) if field.init]
        several = isinstance(given[0], tuple)  # of a choice
        text = ", ".join(map(value_text, given[0] if several else given))
        if several:
            text = f"({text})" if len(given[0]) > 1 else f"({text},)"
        return f"{type(value).__name__}({text})"
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return textwrap.shorten(repr(value), 40, placeholder="...")
    if array.size > _MOST:
        shape = "x".join(map(str, array.shape))
        return f"{shape} from {np.nanmin(array):.4g} to {np.nanmax(array):.4g}"
    return _numbers(array)


def _numbers(array: np.ndarray) -> str:
    # not np.array2string, which follows print options that others set
    return f"{float(array):.5g}" if array.ndim == 0 else f"[{', '.join(map(_numbers, array))}]"


def brief(value: Any, summary: str = "") -> str:
    """A result or data in a few lines: arrays by shape and range, long lists by their length.

    Args:
        value: an instance of a dataclass; what is empty in it is left out.
        summary: what to say first.
    """
    lines = [f"{type(value).__name__}{': ' * bool(summary)}{summary}"]
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        if field.repr and own is not None and not (isinstance(own, Sized) and not len(own)):
            lines.append(f"  {field.name:<18} {_brief_field(own)}")
    return "\n".join(lines)


def _brief_field(own: Any) -> str:
    if isinstance(own, np.ndarray | jax.Array) and np.size(own) > _MOST:
        shape = "x".join(map(str, np.shape(own)))
        numbers = f" from {np.min(own):.4g} to {np.max(own):.4g}" if own.dtype.kind in "fiu" else ""
        return f"{own.dtype} {shape}{numbers}"
    if isinstance(own, str | PurePath):
        return textwrap.shorten(str(own), WIDTH - 22, placeholder="...")
    if dataclasses.is_dataclass(own):
        return textwrap.shorten(repr(own).split("\n")[0], WIDTH - 22, placeholder="...")
    items = list(own.values()) if isinstance(own, dict) else own if isinstance(own, list | tuple) else ()
    if any(map(_is_large, items)):
        return f"{len(items)} of them"
    text = " ".join(repr(own).split())
    return text if len(text) <= WIDTH - 22 else f"{text[: WIDTH - 25]}..."


def _is_large(item: Any) -> bool:
    return isinstance(item, np.ndarray | jax.Array) or dataclasses.is_dataclass(item)


def mixture_html(mixture: Any) -> str:
    """The shares, and a table for each recipe."""
    parts = zip(mixture.shares, mixture.recipes.values())
    return "".join(f"<p>{100 * share:.3g} %</p>{recipe_html(recipe)}" for share, recipe in parts)


def params_text(params: Any) -> str:
    """`ShotReadNoise(shot=0.0001, read=Uniform(0, 0.1))`."""
    fields = (f"{name}={value_text(getattr(params, name))}" for name in specs(type(params)))
    return f"{type(params).__name__}({', '.join(fields)})"


def params_html(params: Any) -> str:
    """A table: each parameter with its value, bounds, unit and meaning."""
    head = ("parameter", "value", "bounds", "unit", "meaning")
    rows = [(name, *about) for name, *about in _about(params)]
    return f"<b>{_safe(type(params).__name__)}</b>{_table(head, rows)}"


def node_text(node: Any) -> str:
    """A stage as it is made, or a line for each stage of a pipeline."""
    if _is_stage(node):
        named = [f"name={node.name!r}"] if node.name != node.fn.__name__ else []
        return f"stage({', '.join([repr(node.fn.__name__), *named, *_options(node)])})"
    head = f"{type(node).__name__} {node.name!r}: {node.domain_in.name} -> {node.domain_out.name}"
    return "\n".join([head, *(_line(depth, n, _options(n)) for depth, n in _within(node))])


def recipe_text(recipe: Any) -> str:
    """A line for each stage, with its options and what its parameters are drawn from."""
    lines = []
    for depth, node in _within(recipe.chain):
        own = recipe.prior.get(node.name)
        drawn = [f"{n}={value_text(getattr(own, n))}" for n in specs(type(own))] if own is not None else []
        lines.append(_line(depth, node, [*_options(node), *drawn]))
    return "\n".join([*textwrap.wrap(f"Recipe {recipe.name!r}: {recipe.description}", WIDTH), *lines])


def node_html(node: Any) -> str:
    """A table of the stages of a pipeline with the defaults of their parameters, bounds and units."""
    return _stages_html(f"{type(node).__name__} {node.name}", node, node.init())


def recipe_html(recipe: Any) -> str:
    """A table of the stages, what each parameter is drawn from, its bounds and unit."""
    return _stages_html(f"Recipe {recipe.name}: {recipe.description}", recipe.chain, recipe.prior)


def _stages_html(title: str, chain: Any, values: dict[str, Any]) -> str:
    rows: list[Sequence[str]] = []
    for depth, node in [(0, chain)] if _is_stage(chain) else _within(chain):
        own = values.get(node.name)
        about: list[Any] = list(_about(own)) if own is not None else []
        for i, (name, *rest) in enumerate(about or [("", "", "", "", "")]):
            first = ("\u2003" * depth + node.name, ", ".join(_options(node))) if i == 0 else ("", "")
            rows.append((*first, name, *rest))
    head = ("stage", "options", "parameter", "value", "bounds", "unit", "meaning")
    return f"<b>{_safe(title)}</b>{_table(head, rows)}"


def _about(params: Any) -> Iterator[tuple[str, str, str, str, str]]:
    for name, spec in specs(type(params)).items():
        bounds = f"{spec.bounds[0]:g} to {spec.bounds[1]:g}{', log' if spec.scale == 'log' else ''}"
        yield name, value_text(getattr(params, name)), bounds, spec.unit, spec.doc


def _within(node: Any, depth: int = 0) -> Iterator[tuple[int, Any]]:
    """What is in a composition, with how deep it is."""
    for inner in getattr(node, "nodes", ()) or filter(None, [getattr(node, "node", None)]):
        yield depth, inner
        yield from _within(inner, depth + 1)


def _is_stage(node: Any) -> bool:
    return hasattr(node, "fn")  # nodes are defined above this module


def _options(node: Any) -> list[str]:
    if not _is_stage(node):
        return [f"({type(node).__name__})"]
    return [f"{name}={textwrap.shorten(repr(value), 40)}" for name, value in node.static]


def _line(depth: int, node: Any, about: Iterable[str]) -> str:
    name = f"{'  ' * (depth + 1)}{node.name}"
    return textwrap.fill(
        f"{name:<24} {', '.join(about)}".rstrip(), WIDTH, subsequent_indent=" " * 25, break_long_words=False
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def row(tag: str, cells: Sequence[str]) -> str:
        return f"<tr>{''.join(f'<{tag}>{_safe(cell)}</{tag}>' for cell in cells)}</tr>"

    return f"<table>{row('th', head)}{''.join(row('td', cells) for cells in rows)}</table>"


def _safe(text: str) -> str:
    return html.escape(text)
