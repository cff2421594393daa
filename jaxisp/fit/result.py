"""What a fit gives: the camera, and its figures on what it did not see."""

import dataclasses
from typing import Any

import numpy as np

from jaxisp.fit.curvature import Identified
from jaxisp.fit.tiles import HOW
from jaxisp.recipe import Recipe
from jaxisp.shown import brief


@dataclasses.dataclass(frozen=True, repr=False)
class PairResult:
    """Figures of one pair, of the fitted and of the held-out tiles.

    Args:
        shift: moves the RAW onto the JPEG [px]: y, x.
        noise: of held-out flat regions, and the detail at edges; pairs of numbers are (render, JPEG).
        held_out_whole_shift: held-out PSNR with the shift rounded to whole pixels, which no interpolation
            smooths [dB].
        flags: what says that no global camera made this JPEG.
        notes: what was done to the pair.
        start, render, target: (H, W, 3), the middle of large pictures.
    """

    __repr__ = brief

    name: str
    psnr: float
    ssim: float
    held_out_psnr: float
    held_out_ssim: float
    shift: tuple[float, float]
    start: np.ndarray = dataclasses.field(repr=False)
    render: np.ndarray = dataclasses.field(repr=False)
    target: np.ndarray = dataclasses.field(repr=False)
    noise: dict[str, Any] = dataclasses.field(default_factory=dict)
    held_out_whole_shift: float = float("nan")
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The figures, without the pictures."""
        return {
            "name": self.name,
            "psnr": self.psnr,
            "ssim": self.ssim,
            "held_out_psnr": self.held_out_psnr,
            "held_out_ssim": self.held_out_ssim,
            "shift_px": list(self.shift),
            "held_out_psnr_whole_shift": self.held_out_whole_shift,
            "noise": self.noise,
            "flags": list(self.flags),
            "notes": list(self.notes),
        }


@dataclasses.dataclass(frozen=True)
class Scenes:
    """Figures of pairs on cameras that were fitted without them.

    Args:
        names: of the pairs.
        psnr, ssim: a figure each.
        how: what was left out.
    """

    names: tuple[str, ...]
    psnr: tuple[float, ...]
    ssim: tuple[float, ...]
    how: str

    def as_dict(self) -> dict[str, Any]:
        """The means, and each pair's."""
        each = zip(self.names, self.psnr, self.ssim)
        return {
            "psnr": float(np.mean(self.psnr)),
            "ssim": float(np.mean(self.ssim)),
            "how": self.how,
            "pairs": [{"name": name, "psnr": psnr, "ssim": ssim} for name, psnr, ssim in each],
        }


@dataclasses.dataclass(frozen=True, repr=False)
class FitResult:
    """A fitted camera, how well it does, and the loss at each step.

    Args:
        camera: mosaic to encoded sRGB.
        losses: objective at each Gauss-Newton step; each phase has its own scale.
        phases: the name of the phase that each of these steps is of.
        design: the discrete choices in words, and what each one tried gave.
        identified: each fitted number with its relative standard error.
        at_bound: names of the parameters that ended at a bound.
        lens_px: displacement in the corner, of all colours and of red and blue against green; empty where
            there is none.
        per_image: by pair, the parameters that each image has of its own, by stage and field.
        failed: pairs that could not be used, with the reason.
        scenes: figures on other scenes than those fitted, where they were measured.
    """

    camera: Recipe
    pairs: list[PairResult]
    losses: np.ndarray
    phases: tuple[str, ...]
    seconds: float
    how: str = HOW
    failed: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    design: str = ""
    tried: list[tuple[str, float]] = dataclasses.field(default_factory=list)
    identified: list[Identified] = dataclasses.field(default_factory=list)
    at_bound: list[str] = dataclasses.field(default_factory=list)
    per_image: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    resumed: bool = False
    lens_px: dict[str, float] = dataclasses.field(default_factory=dict)
    scenes: Scenes | None = None

    def __repr__(self) -> str:
        found = self.as_dict()["held_out"]
        return brief(self, f"held out {found['psnr']:.2f} dB, SSIM {found['ssim']:.3f}")

    @property
    def unidentified(self) -> list[str]:
        """Names of the parameters that these pairs do not tell to 5 %."""
        return [p.name for p in self.identified if not p.known]

    def as_dict(self) -> dict[str, Any]:
        """The figures, as `jaxisp fit --json` prints them."""
        tiles = {
            "psnr": float(np.mean([p.held_out_psnr for p in self.pairs])),
            "ssim": float(np.mean([p.held_out_ssim for p in self.pairs])),
            "how": self.how,
        }
        return {
            "pairs": [p.as_dict() for p in self.pairs],
            "held_out": self.scenes.as_dict() if self.scenes else tiles,
            "held_out_tiles": tiles,
            "seconds": round(self.seconds, 2),
            "design": self.design,
            "tried": [{"design": text, "objective": value} for text, value in self.tried],
            "parameters": [
                {"name": p.name, "value": p.value, "relative_error": p.error, "identified": p.known}
                for p in self.identified
            ],
            "unidentified": self.unidentified,
            "at_bound": self.at_bound,
            "per_image": self.per_image,
            "lens_px": self.lens_px,
            "resumed": self.resumed,
            "failed": [{"file": name, "reason": reason} for name, reason in self.failed],
        }
