"""A page of headings, text, tables and pictures, written as one HTML file."""

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

from jaxisp.errors import printable_lines
from jaxisp.io.files import write_text

_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("jaxisp", "report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
)


@dataclass
class Page:
    """Add blocks in reading order, then `write`."""

    title: str
    lead: str = ""
    blocks: list[dict[str, Any]] = field(default_factory=list)

    def heading(self, text: str, lead: str = "") -> None:
        """A section's heading, and a sentence or two that say what it shows."""
        self.blocks.append({"kind": "heading", "text": text, "lead": lead})

    def figures(self, pictures: Iterable[tuple[str, Any]], *, magnify: int = 1) -> None:
        """A row of (caption, picture): (H, W, 3) or (H, W) in [0, 1], or a matplotlib figure.

        `magnify` shows a small picture larger without smoothing.
        """
        rendered = [{"caption": caption, "uri": _uri(picture, magnify)} for caption, picture in pictures]
        self.blocks.append({"kind": "figures", "figures": rendered})

    def link(self, text: str, target: str) -> None:
        """A link to a file beside the page, or in a folder beside it."""
        self.blocks.append({"kind": "link", "text": text, "target": target})

    def table(self, headers: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """A table; numbers are best given as formatted text."""
        self.blocks.append({"kind": "table", "headers": headers, "rows": [list(map(str, r)) for r in rows]})

    def html(self) -> str:
        """The whole page as text."""
        template = _ENVIRONMENT.get_template("page.html")
        return printable_lines(template.render(title=self.title, lead=self.lead, blocks=self.blocks))

    def write(self, path: str | Path) -> None:
        """Write the page, whole or not at all."""
        write_text(path, self.html())


def _uri(picture: Any, magnify: int) -> str:
    buffer = io.BytesIO()
    if hasattr(picture, "savefig"):
        picture.savefig(buffer, format="png", dpi=160, bbox_inches="tight")
    else:
        levels = np.round(255 * np.clip(np.asarray(picture, np.float64), 0, 1)).astype(np.uint8)
        levels = levels.repeat(magnify, axis=0).repeat(magnify, axis=1)
        Image.fromarray(levels).save(buffer, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
