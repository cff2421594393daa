"""The reference phones' own JPEGs: their code and formulas are not the fitter's."""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from experiments.fit_phones.common import SEED, Cases, Run, fitted, framed, short
from jaxisp.samples import PHONES, Phone, write_pairs


def runs(data: Path | None) -> dict[str, Run]:
    return {name: partial(own_jpegs, name, phone) for name, phone in PHONES.items()}


def own_jpegs(name: str, phone: Phone) -> dict[str, Any]:
    """A reference phone's own JPEGs: its code and formulas are not the fitter's."""
    with tempfile.TemporaryDirectory() as folder:
        write_pairs(folder, phone, framed(), SEED)
        return short(fitted(f"phone-{name}", folder))


def page(cases: Cases) -> list[str]:
    lines = [
        "## The reference phones' own JPEGs, eight pairs each",
        "",
        "| phone | held out [dB / SSIM] | worst pair [dB] | chosen |",
        "| --- | --- | --- | --- |",
    ]
    return lines + [
        f"| {name} | {r['held_out_psnr']:.2f} / {r['held_out_ssim']:.4f} | {r['worst']:.2f} | {r['design']} |"
        for name, r in cases.items()
    ]
