"""docs/results/denoisers.md from denoisers.json and noise-spectra.json."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

FINDINGS = Path(__file__).with_name("findings.md")
"""What the tables show, in words."""
TILE = 32  # px
WIDE = 12  # px, the wavelength from which noise counts as wide
NOTE = """## How to read the figures

PSNR [dB] and SSIM (Gaussian window) are taken in linear light. The clean picture is aligned first
(translation and scale, sub-pixel; in the first table each channel where it lies elsewhere). It is then
given the mean and standard deviation of the other picture, per channel, as in Jaroensri et al. 2019. After
+- stands the standard deviation over seeds. `change` is the PSNR of a network's output against its input,
encoded: high where the network does nothing. All networks of a table share configuration, clean patches and
their order. They differ only in the recipe.

| set | pictures |
| --- | --- |
| `iphone8` | five crops of 200x200: a phone's JPEG against the mean of a RAW burst |
| `polyu` | nine JPEGs of full-frame cameras against means of 500 (middle 512x512) |
| `sidd` | six phone crops before a phone's own processing (middle 512x512 at most) |
| `cameras` | three simulated cameras of other code than the package, on pictures no network has seen |
| `raw` | those pictures with sensor noise (Poisson factor 0.01, read 0.05) and Kodak demosaicking alone |
"""


def document(tables: Mapping[str, Mapping[str, Any]], spectra: Sequence[Mapping[str, Any]] = ()) -> str:
    """The whole page: findings, tables, and the noise on flat areas where it was measured."""
    parts = ["# Denoisers trained on simulated cameras", "", FINDINGS.read_text(), NOTE]
    parts += [text(tables[key]) for key, text in _OWN.items() if key in tables]
    parts += [table_text(tables[key]) for key in sorted(tables, key=_order) if key not in _OWN]
    return "\n".join(parts + ([spectra_text(spectra)] if spectra else []))


def tables(folder: Path) -> dict[str, Any]:
    """What denoisers.json of a folder holds."""
    file = folder / "denoisers.json"
    return json.loads(file.read_text()) if file.exists() else {}


def save(folder: Path, name: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """Put a table into denoisers.json in place of the one that was there, and write denoisers.md."""
    kept = tables(folder) | {name: dict(table)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "denoisers.json").write_text(json.dumps(kept, indent=1) + "\n")
    write(folder)
    return kept[name]


def write(folder: Path) -> None:
    """Write the page from the JSON in its folder."""
    found = [folder / f"{name}.json" for name in ("denoisers", "noise-spectra")]
    tables, spectra = (json.loads(path.read_text()) if path.exists() else {} for path in found)
    (folder / "denoisers.md").write_text(document(tables, spectra))


def classical_text(table: Mapping[str, Any]) -> str:
    """Classical denoisers on the real sets, by both measures; and where the channels were found."""
    rows = table["rows"]
    sets, names = _unique(row["set"] for row in rows), _unique(row["denoiser"] for row in rows)
    by_key = {(row["denoiser"], row["set"]): row for row in rows}
    head = ["denoiser", *(f"{s}: {what}" for s in sets for what in ("strength", "PSNR / SSIM", "fixed tone"))]
    body = []
    for name in names:
        cells = [name]
        for which in sets:
            row = by_key.get((name, which))
            if row is None:
                cells += [""] * 3
                continue
            mean = row["mean"]
            cells += [
                _strength(row),
                f"{mean['psnr']:.2f} / {mean['ssim']:.3f}",
                f"{mean['psnr_fixed']:.2f} / {mean['ssim_fixed']:.3f}",
            ]
        body.append(cells)
    places = [
        [f"{which} {pair['name']}", pair["aligned_by"] if pair["aligned"] else "not aligned",
         *(f"{dy:+.2f}, {dx:+.2f}" for dy, dx in pair["channel_shift_px"])]
        for which in sets for pair in by_key["noisy input", which]["pairs"]
    ]  # fmt: skip
    left_out = ", ".join(table["left_out"])
    return "\n".join([
        f"## {table['title']}", "",
        "PSNR / SSIM is the paper's measure. Fixed tone compares with a clean picture of one tone for all",
        "rows. polyu and sidd: the middle 248x248 of each picture. Strength: mean over pictures, of 255 or",
        "in px, chosen by `python -m experiments.denoisers.strengths DATA --work RUNS` on Kodak and CBSD68",
        "pictures with simulated noise. In hindsight: what factor on it (1 to 4) is best on the set itself",
        "by the fixed tone; no fair row.",
        f"Not installed and left out: {left_out}." if left_out else "", "",
        _markdown(head, body), "",
        "Where each channel of the clean picture is read, beyond the place of the whole (dy, dx) [px]:", "",
        _markdown(["picture", "aligned by", "R", "G", "B"], places), "",
        f"`{table['command']}`", "",
    ])  # fmt: skip


def one_camera_text(table: Mapping[str, Any]) -> str:
    """The package's network as it is, adapted, and trained on real pairs."""
    by_key = {(row["denoiser"], row["set"]): row for row in table["rows"]}
    names = _unique(row["denoiser"] for row in table["rows"])
    body = []
    for camera in _unique(row["set"] for row in table["rows"]):
        means = [by_key[name, camera]["mean"] for name in names]
        cells = [f"{mean['psnr_fixed']:.2f} / {mean['psnr']:.2f} / {mean['ssim']:.3f}" for mean in means]
        gaps = [f"{means[-1]['psnr_fixed'] - mean['psnr_fixed']:+.2f}" for mean in means[:-1]]
        found = by_key["adapted", camera]
        noise = ", ".join(
            f"{found['effects'][f'noise of {part} [1/255]']:.1f}" for part in ("luma", "chroma")
        )
        body.append([camera, str(len(found["pairs"])), *cells, *gaps, noise, f"{found['strange']:.0%}"])
    head = [
        "camera", "pictures", *names, *(f"PGap, {name}" for name in names[:-1]), "noise found",
        "unlike the recipe",
    ]  # fmt: skip
    return "\n".join([
        f"## {table['title']}", "",
        "PSNR with a fixed tone / PSNR / SSIM of the paper's measure, on the pictures' middles. All begin",
        f"with the package's network; the two others are trained for {table['steps']} steps of 16 patches.",
        "Adapted saw the noisy pictures alone. Real pairs saw pairs of other scenes, in three folds.",
        "In adapted the weights at the start keep a half, in real pairs nothing. PGap is the fixed-tone PSNR",
        "of real pairs less that of the network named. Noise: of luma and chroma, of 255.", "",
        _markdown(head, body), "",
        f"`{table['command']}`", "",
    ])  # fmt: skip


def converters_text(table: Mapping[str, Any]) -> str:
    """Denoisers on cameras of other programs."""
    rows = table["rows"]
    names = _unique(row["denoiser"] for row in rows)
    by_key = {(row["denoiser"], row["camera"], row["scenes"]): row["mean"] for row in rows}
    body = []
    for camera, scenes in _unique((row["camera"], row["scenes"]) for row in rows):
        means = [by_key[name, camera, scenes] for name in names]
        cells = [f"{mean['psnr_fixed']:.2f} / {mean['ssim_fixed']:.3f}" for mean in means]
        body.append([camera, scenes, *cells])
    return "\n".join([
        f"## {table['title']}", "",
        "PSNR [dB] / SSIM with a fixed tone, all blind, means of six scenes of 256x256. Scenes are as soft",
        "as a lens makes them, or as sharp as a picture that was made smaller. They are of photographs that",
        "the network learned from, seen by other cameras: these rows chose the data, and prove nothing.",
        "Other networks, by the names of their files, are what it was before, or is the mean of. Of the",
        "classical ones BM3D and FFDNet were left out.", "",
        _markdown(["camera", "scenes", *names], body), "",
        f"`{table['command']}`", "",
    ])  # fmt: skip


_OWN = {"classical": classical_text, "converters": converters_text, "one_camera": one_camera_text}
"""Tables that are not of trainings that differ in their recipe."""


def _strength(row: Mapping[str, Any]) -> str:
    values = [pair["strength"] for pair in row["pairs"] if "strength" in pair]
    if not values:
        return ""
    mean = float(np.mean(values))
    return f"{mean:.2f} px" if row["denoiser"].startswith("gaussian") else f"{255 * mean:.1f}"


def spectra_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """What `noise_spectra` found."""
    lines = [
        "## Noise on flat areas",
        "",
        "`python -m experiments.denoisers.noise_spectra DATA --work RUNS`",
        "",
        "Noisy minus clean in the camera's tone, encoded, without the plane of each tile. The flattest",
        f"quarter of tiles of {TILE}x{TILE} counts. Lags are correlations between neighbours, across and",
        f"down. Wide is the share of power in wavelengths of {WIDE} px and more. Chroma is the mean power of",
        "Cb and Cr over that of luma. `iphone8 01` and the like are single crops.",
        "",
        "| pictures | luma std [8 bit] | lag 1 | lag 2 | wide luma | chroma / luma | wide chroma |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        cells = [f"{row['std']:.1f}", *(f"{row[k]:.2f}" for k in ("lag1", "lag2", "wide_luma"))]
        cells += [f"{row['chroma']:.3f}", f"{row['wide']:.2f}"]
        lines.append(f"| {row['pictures']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


_ORDER = ("noise_models", "ablations", "demosaicking", "sanity", "raw_input")


def _order(key: str) -> tuple[int, str]:
    name = key.split()[0]
    return _ORDER.index(name) if name in _ORDER else len(_ORDER), key


def table_text(table: Mapping[str, Any]) -> str:
    """A table: the means of each set, then each picture of iphone8, then what it was made with."""
    rows = table["rows"]
    sets = _unique(row["set"] for row in rows)
    lines = [f"## {table['title']}", "", _means(rows, sets), ""]
    if "iphone8" in sets:
        lines += ["iphone8, each crop (mean over seeds):", "", _per_picture(rows, "iphone8"), ""]
    settings = ", ".join(f"{k} {v}" for k, v in table["settings"].items() if k in _SHOWN)
    seeds = _unique(str(row["seed"]) for row in rows if row["seed"] is not None)
    lines += [
        f"`{table['command']}`",
        "",
        f"Scale `{table['scale']}`: {settings}; seeds {', '.join(seeds)}; {table['machine']['processor']}, "
        f"{table['machine']['cores']} cores.",
        "",
    ]
    return "\n".join(lines)


_SHOWN = ("model", "steps", "batch", "patch", "lr", "schedule", "optimizer", "loss", "light", "ema")


def _means(rows: Sequence[Mapping[str, Any]], sets: Sequence[str]) -> str:
    head = ["trained on", *(f"{s}: {what}" for s in sets for what in ("PSNR", "SSIM", "change"))]
    body = []
    for name in _unique(row["denoiser"] for row in rows):
        cells = [name]
        for which in sets:
            means = [r["mean"] for r in rows if r["denoiser"] == name and r["set"] == which]
            cells += [_spread([m[key] for m in means], digits) for key, digits in _COLUMNS]
        body.append(cells)
    return _markdown(head, body)


_COLUMNS = (("psnr", 2), ("ssim", 3), ("change", 1))


def _per_picture(rows: Sequence[Mapping[str, Any]], which: str) -> str:
    chosen = [row for row in rows if row["set"] == which]
    names = [pair["name"] for pair in chosen[0]["pairs"]]
    body = []
    for denoiser in _unique(row["denoiser"] for row in chosen):
        runs = [row["pairs"] for row in chosen if row["denoiser"] == denoiser]
        body.append(
            [
                denoiser,
                *(f"{_mean(runs, i, 'psnr'):.2f} / {_mean(runs, i, 'ssim'):.3f}" for i in range(len(names))),
            ]
        )
    return _markdown(["trained on", *names], body)


def _mean(runs: Sequence[Sequence[Mapping[str, Any]]], index: int, key: str) -> float:
    return float(np.mean([pairs[index][key] for pairs in runs]))


def _spread(values: Sequence[float], digits: int) -> str:
    if not values:
        return ""
    text = f"{np.mean(values):.{digits}f}"
    return text if len(values) < 2 else f"{text} +- {np.std(values, ddof=1):.{digits}f}"


def _unique(values: Any) -> list[Any]:
    return list(dict.fromkeys(values))


def _markdown(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
