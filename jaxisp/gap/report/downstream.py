"""The section of report.html about denoisers trained without and with the effects found."""

from collections.abc import Mapping
from typing import Any

from jaxisp.gap.report.words import listed, words

_ARMS = {
    "without": "simulated pairs, without {effects}",
    "with": "simulated pairs, with {effects}",
    "real": "the real pairs that were fitted",
}


def downstream_part(found: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Text and table rows for the report's "downstream"; None if the report has none."""
    if found is None or "skipped" in found:
        return None if found is None else dict(found)
    effects = listed([words(name) for name in found.get("effects", ())]) or "the effects"
    rows = [_row("nothing: the noisy pictures", found["input"])]
    rows += [_row(_ARMS.get(name, name).format(effects=effects), arm) for name, arm in found["arms"].items()]
    return {"rows": rows, "text": _sentence(found["gain"], effects), "how": _how(found)}


def _row(name: str, arm: Mapping[str, Any]) -> dict[str, str]:
    if "psnr_mean" not in arm:
        figures = {"psnr": f"{arm['psnr']:.2f}", "ssim": f"{arm['ssim']:.4f}"}
        return {"name": name, **figures, "psnr_spread": "", "ssim_spread": "", "each": ""}
    return {
        "name": name,
        "psnr": f"{arm['psnr_mean']:.2f}",
        "psnr_spread": f"{arm['psnr_spread']:.2f}",
        "ssim": f"{arm['ssim_mean']:.4f}",
        "ssim_spread": f"{arm['ssim_spread']:.4f}",
        "each": ", ".join(f"{v:.2f}" for v in arm["psnr"]),
    }


def _sentence(gain: Mapping[str, Any], effects: str) -> str:
    own, real = gain["with"], gain["real"]
    text = (
        f"Trained with {effects}, a denoiser changes by {own['psnr_mean']:+.2f} dB "
        f"(spread over seeds {own['psnr_spread']:.2f}) and {own['ssim_mean']:+.4f} SSIM on held-out pairs."
    )
    return f"{text} Trained on as many real pairs it changes by {real['psnr_mean']:+.2f} dB."


def _how(found: Mapping[str, Any]) -> str:
    scenes = found["scenes"]
    return (
        f"{found['metric']}. Model {found['model']}, {found['parameters']} weights, {found['steps']} steps, "
        f"seeds {', '.join(map(str, found['seeds']))}; trained on {scenes['trained']} pictures, measured on "
        f"{scenes['held_out']} others."
    )
