"""The page of `benchmarks.accelerator`, or its part of a page, made from its JSON alone."""

import json
import re
from pathlib import Path
from typing import Any

_TITLE = "# Whole batches and single stages on {device}\n\n"
_PART = re.compile(r"(?<=<!-- generated: accelerator -->\n).*?(?=<!-- end -->)", re.DOTALL)
_INTRODUCTION = """\
Made by `python -m benchmarks.accelerator --stages 1024 --kernels --report PAGE` with jax {jax}; the
page alone with `--render --out RESULTS`.

Medians in ms.

- *in a row*: one of eight calls of which only the last is waited for, as in a training loop.
- *waited for*: one call and its result.
- *kernels*: their time by the device's own clock, and how many run.
- *floor*: a copy that reads and writes as many bytes as the stage has to.
- *kornia*: on the same device, on tensors that are already there, in a row too. Its outputs are compared with
  ours before it is timed.
"""
HEADERS = (
    "what", "images", "in a row", "images/s", "waited for", "kernels", "x floor", "first call", "kornia",
    "x ours", "outputs",
)  # fmt: skip


def write_accelerator(path: Path, results: Path) -> None:
    """Write the page, or the part of it that is marked as generated; what has not been measured is empty."""
    found = json.loads(results.read_text())
    machine = found["machine"]
    device = machine["processor"] if machine["backend"] == "cpu" else machine["device"]
    lines = [HEADERS, ["---"] * len(HEADERS), *map(cells, found["rows"])]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    made = f"{_INTRODUCTION.format(jax=machine['versions']['jax'])}\n{table}\n"
    page = path.read_text() if path.exists() else ""
    path.parent.mkdir(parents=True, exist_ok=True)
    if _PART.search(page):
        path.write_text(_PART.sub(lambda _: made, page))
    else:
        path.write_text(_TITLE.format(device=device) + made)


def cells(row: dict[str, Any]) -> list[str]:
    peer = next(iter(row.get("peers", ())), {})
    listed = row.get("kernels", ())
    ran = f"{row['kernels_ms']:.3f} in {sum(k['times'] for k in listed):.0f}" if listed else ""
    return [
        row["what"],
        f"{row['images']}",
        f"{row['ms']:.3f} ({row['iqr']:.3f})",
        f"{1e3 * row['images'] / row['ms']:,.0f}",
        f"{row['alone_ms']:.3f}",
        ran,
        f"{row['times_floor']}",
        f"{row['first_call_s']} s",
        f"{peer['ms']:.2f}" if "ms" in peer else peer.get("error", ""),
        f"{peer['ratio']:.1f}" if "ratio" in peer else "",
        peer.get("outputs", ""),
    ]
