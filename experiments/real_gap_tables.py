"""The page of `real_gap`: what may be claimed of each set, as a table and as a sentence."""

from collections.abc import Mapping, Sequence
from math import log10
from typing import Any

from experiments.withheld.tables import left_by, table
from jaxisp.gap.report.sentences import reached
from jaxisp.gap.report.words import any_of, finite, listed, number, words

Record = Mapping[str, Any]
TITLES = {
    "iphone7": "iPhone 7",
    "iphone8": "iPhone 8",
    "canon": "PolyU, Canon 5D II",
    "sony": "PolyU, Sony A7 II",
    "sidd": "SIDD",
}
HEAD = (
    "pictures", "pairs", "gap before", "after", "floor", "on these axes, share", "causes, share closed",
    "alternatives", "left", "denoisers (spread over seeds)", "seconds",
)  # fmt: skip
_TEXT = """# The diagnosis of real photographs

```sh
python -m experiments.real_gap DATA --downstream --out docs/results/real-gap.json
```

Nobody knows the truth of these pictures; the table states what the diagnosis says. All gaps are of held-out
pairs. RAW+JPEG gaps are in squared 8-bit steps, clean+noisy gaps in units of chance and harmless differences,
squared. Decibels are of these mean squares. Where no effect accounts for a gap, "after" is the gap with the
refused effect added, and denoisers are trained with that. Square brackets hold 90 % intervals.
"""


def share(value: Any, ci: Sequence[Any] | None = None) -> str:
    """A share of the gap, with its interval where it has one."""
    text = f"{value:.2f}" if finite(value) else "unknown"
    return text if ci is None else f"{text} [{', '.join(share(v) for v in ci)}]"


def nearest(record: Record) -> Record | None:
    """What was refused as the cause, where there is none."""
    return record["unexplained"].get("nearest") if record["verdict"] == "unknown" else None


def after(record: Record) -> tuple[float, list[str]]:
    """The gap with the causes in the simulator, or with what was refused, and what these are."""
    gap, near = record["gap"], nearest(record)
    if near is None:
        return gap["after"], record["causes"]
    return left_by(near, gap), near["effects"]


def alike(record: Record, cause: str) -> list[str]:
    return record["alternatives"].get(cause, [])


def pairs(record: Record) -> str:
    fit, held = record["pairs"]["fit"], record["pairs"]["held_out"]
    if any(name.endswith("tiles)") for name in held):
        return f"{record['kind']}: one, half of its tiles held out"
    return f"{record['kind']}: {len(fit) + len(held)}, {len(held)} held out"


def causes(record: Record) -> str:
    near, closed, ci = nearest(record), record["closed"], record["ci"]
    if near is not None:
        return f"unknown; refused: {listed([words(e) for e in near['effects']])} {share(near['closed'])}"
    return "; ".join(f"{words(c)} {share(closed[c], ci[c])}" for c in record["causes"]) or record["verdict"]


def left(record: Record) -> str:
    """How much of the gap the causes leave, or what was refused would, and on which axes."""
    rest, near = record["unexplained"], nearest(record)
    if record["verdict"] == "none":
        return "nothing that counts"
    text = ", ".join([f"{rest['share']:.0%}", *map(words, rest["axes"])])
    if near is None:
        return text
    with_it = ", ".join([f"{1 - near['closed']:.0%}", *map(words, near["axes"])])
    return f"{text}; with what was refused {with_it}"


def row(name: str, record: Record) -> list[str]:
    gap, (least, added) = record["gap"], after(record)
    before, end = number(gap["before"]), number(least) if added else ""
    interval = (
        f" [{', '.join(map(number, gap['ci']))}]"  # of what the causes leave, or of the gap without any
    )
    return [
        TITLES[name],
        pairs(record),
        before if record["causes"] else before + interval,
        end + interval if record["causes"] else end,
        number(gap["floor"]),
        ", ".join(f"{words(a['axis'])} {share(a['share'], a.get('ci'))}" for a in record["axes"]),
        causes(record),
        "; ".join(f"{words(c)}: {any_of(alike(record, c))}" for c in record["causes"] if alike(record, c)),
        left(record),
        denoisers(record),
        f"{record['seconds']:.0f}",
    ]


def claim(record: Record) -> str:
    """The finding in a sentence that can be quoted alone, and what newer reports say beside it."""
    gap, (least, added) = record["gap"], after(record)
    text = f"A gap of {number(gap['before'])}"
    if added:
        each = [words(c) + (f" (or {any_of(alike(record, c))})" if alike(record, c) else "") for c in added]
        text += f", {number(least)} after adding {listed(each)}"
        text += "" if nearest(record) is None else ", which does not account for it"
    text += f", floor {number(gap['floor'])} ({levels(gap, least, bool(added))})"
    if record["axes"]:
        text += f", on these axes: {listed([words(a['axis']) for a in record['axes']])}"
    if not added:
        none = "so near the floor that nothing is missing"
        text += f"; {none if record['verdict'] == 'none' else 'no effect comes near it'}"
    if said := reached(gap, bool(record["causes"])):
        text += f". {said.removesuffix('.')}"
    if following := record["unexplained"].get("next_measurement"):
        text += f". What could tell more: {following}"
    return f"{text}."


def levels(gap: Mapping[str, float], least: float, closed: bool) -> str:
    """The gaps in decibels above the floor, which every kind of data has."""
    before, end = (10 * log10(max(own / gap["floor"], 1.0)) for own in (gap["before"], least))
    return f"{before:.1f} dB above it before" + f", {end:.1f} dB left" * closed


def denoisers(record: Record) -> str:
    """What the finding is worth to a denoiser: PSNR, and its spread over seeds."""
    found = record.get("downstream")
    if found is None or "skipped" in found:
        return f"none: {found['skipped']}" if found else ""
    without, added, real = (
        f"{found['arms'][arm]['psnr_mean']:.2f} dB ({found['arms'][arm]['psnr_spread']:.2f})"
        for arm in ("without", "with", "real")
    )
    effects, noisy = listed([words(e) for e in found["effects"]]), found["input"]["psnr"]
    return f"{without} without, {added} with {effects}, {real} on real pairs; noisy pictures {noisy:.2f} dB"


def markdown(found: Mapping[str, Record]) -> str:
    """The page; sets that failed are named with the reason."""
    good = {name: record for name, record in found.items() if "failed" not in record}
    lines = [f"- **{TITLES[name]}.** {claim(record)}" for name, record in good.items()]
    lines += [f"- **{TITLES[n]}** failed: {r['failed']}" for n, r in found.items() if n not in good]
    return "\n".join(
        [_TEXT, "## Public claim", "", table(HEAD, (row(n, r) for n, r in good.items())), *lines, ""]
    )
