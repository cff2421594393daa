"""What a calibration found: in a TOML file, and as stages in the place of a recipe's own noise."""

import dataclasses
import itertools
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from jaxisp.errors import InputError, short
from jaxisp.io.files import PathLike, parse_toml, read_text, write_text
from jaxisp.params import specs
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.recipe import Recipe
from jaxisp.recipes import RecipeLike, find_recipe
from jaxisp.shown import brief
from jaxisp.stages.noise import ColumnNoise, GaussianNoise, HeavyTailedNoise, Prnu, RowNoise, ShotReadNoise

FIGURES = {
    "shot": ("level", "variance per unit of light; its inverse is the electrons at white"),
    "read": ("level", "standard deviation in the dark from frame to frame, rounding included"),
    "row": ("level", "standard deviation of the rows' offsets, temporal and fixed"),
    "row_temporal": ("level", "of those, what changes from frame to frame"),
    "row_fixed": ("level", "of those, what stays"),
    "column": ("level", "standard deviation of the columns' offsets, temporal and fixed"),
    "column_temporal": ("level", "of those, what changes from frame to frame"),
    "column_fixed": ("level", "of those, what stays"),
    "prnu": ("1", "standard deviation of the pixels' gains"),
    "dsnu": ("level", "standard deviation of the pixels' fixed offsets"),
    "tail": ("1", "Tukey's h of the read noise; 0 is Gaussian"),
    "black": ("level", "what is left of black after the file's own black level"),
    "hot_pixels": ("1", "share of hot and dead pixels"),
    "dark_signal": ("level/s", "growth of black with the exposure time"),
}
"""The figures of a calibration: unit and meaning. A level is a share of white less black."""

KIND, VERSION = "sensor noise", 1
NOISE_STAGES = frozenset(
    {
        "gaussian_noise", "shot_read_noise", "poisson_noise", "heavy_tailed_noise", "correlated_noise",
        "row_noise", "column_noise", "prnu",
    }
)  # fmt: skip
"""Functions of the stages that `with_noise` puts calibrated ones in the place of."""


class Figure(NamedTuple):
    """A value and its standard error."""

    value: float
    error: float


@dataclasses.dataclass(frozen=True, repr=False)
class Noise:
    """The noise at one ISO number.

    Args:
        iso: the number, None where the files state none.
        figures: by the names of `FIGURES`; `dark_signal` is there where it was measured.
        black, white: the file's own levels [DN].
        cfa: the pattern of the frames.
        shot_by_place: at the four places of the cell, row by row.
        stated: shot and read of green in the DNG's NoiseProfile, None where it has none.
        frames: how many flat and dark ones.
        points: level, temporal and spatial variance of blocks, for plots; not in the file.
        profiles: of rows and columns in the dark, for plots; not in the file.
    """

    __repr__ = brief

    iso: float | None
    figures: Mapping[str, Figure]
    black: float = 0.0
    white: float = 1.0
    cfa: str = ""
    shot_by_place: tuple[Figure, ...] = ()
    stated: tuple[float, float] | None = None
    frames: tuple[int, int] = (0, 0)
    points: tuple[np.ndarray, ...] = dataclasses.field(default=(), repr=False, compare=False)
    profiles: tuple[np.ndarray, ...] = dataclasses.field(default=(), repr=False, compare=False)

    def value(self, name: str) -> float:
        """A figure's value, 0 where it was not measured."""
        return self.figures[name].value if name in self.figures else 0.0

    @property
    def electrons(self) -> dict[str, float]:
        """Gain [DN/e-], read noise and capacity at white [e-], and dynamic range [dB]."""
        shot, read = self.value("shot"), self.value("read")
        if shot <= 0:
            return {}
        found = {"gain": shot * (self.white - self.black), "read": read / shot, "capacity": 1 / shot}
        return found | ({"dynamic_range": 20 * math.log10(1 / read)} if read > 0 else {})

    @property
    def heavy_tailed(self) -> bool:
        """Whether the tails are those of no Gaussian: beyond three standard errors."""
        own = self.figures.get("tail", Figure(0.0, 0.0))
        return own.value > 3 * own.error and own.value > 0

    def stages(self) -> tuple[Chain, Params]:
        """Stages that draw this noise on linear light of white 1, and their parameters.

        Read noise is a stage of its own where it has heavy tails.
        """
        v = self.value
        read = 0.0 if self.heavy_tailed else v("read")
        params: Params = {
            "prnu": Prnu(std=_within(Prnu, "std", v("prnu"))),
            "shot_read_noise": ShotReadNoise(
                shot=_within(ShotReadNoise, "shot", v("shot")), read=_within(ShotReadNoise, "read", read)
            ),
        }
        nodes = [stage("prnu"), stage("shot_read_noise")]
        if self.heavy_tailed:
            tails = {"std": v("read"), "tail": v("tail")}
            params["read_noise"] = HeavyTailedNoise(
                **{n: _within(HeavyTailedNoise, n, own) for n, own in tails.items()}
            )
            nodes.append(stage("heavy_tailed_noise", name="read_noise"))
        for name, kind, figure in (("row_noise", RowNoise, "row"), ("column_noise", ColumnNoise, "column")):
            params[name] = kind(std=_within(kind, "std", v(figure)))
            nodes.append(stage(name))
        params["dark_nonuniformity"] = GaussianNoise(std=_within(GaussianNoise, "std", v("dsnu")))
        nodes.append(stage("gaussian_noise", name="dark_nonuniformity"))
        return Chain(tuple(nodes), "sensor_noise"), params


def _within(kind: type, field: str, value: float) -> np.float32:
    low, high = specs(kind)[field].bounds
    return np.float32(min(max(value, low), high))


@dataclasses.dataclass(frozen=True, repr=False)
class Calibrated:
    """The noise of a camera by ISO number, ascending.

    Args:
        camera: its name.
        noise: one entry an ISO number.
        notes: what to know about the frames.
    """

    __repr__ = brief

    camera: str
    noise: tuple[Noise, ...]
    notes: tuple[str, ...] = ()

    def at(self, iso: float | None = None) -> Noise:
        """The noise at an ISO number; between two that were measured, on straight lines of logarithms.

        Raises:
            InputError: the number is needed and was not given, or is outside what was measured.
        """
        known = [n.iso for n in self.noise if n.iso is not None]
        if len(self.noise) == 1 and (iso is None or not known):
            return self.noise[0]
        if iso is None:
            raise InputError(f"the noise is of ISO {', '.join(f'{k:g}' for k in known)}: say which")
        for one in self.noise:
            if one.iso == iso:
                return one
        if not known or not min(known) <= iso <= max(known):
            there = ", ".join(f"{k:g}" for k in known)
            raise InputError(f"no noise was measured at ISO {iso:g}; there is {there}")
        below = max((n for n in self.noise if n.iso and n.iso < iso), key=lambda n: n.iso or 0)
        above = min((n for n in self.noise if n.iso and n.iso > iso), key=lambda n: n.iso or 0)
        assert below.iso and above.iso
        share = math.log(iso / below.iso) / math.log(above.iso / below.iso)
        both = {n: (below.figures[n], above.figures[n]) for n in below.figures if n in above.figures}
        figures = {n: Figure(*(_between(a, b, share) for a, b in zip(*pair))) for n, pair in both.items()}
        return dataclasses.replace(below, iso=iso, figures=figures, shot_by_place=(), stated=None)

    def to_toml(self) -> str:
        """The file's text; `from_toml` reads it back."""
        return tomli_w.dumps(
            {
                "kind": KIND,
                "version": VERSION,
                "camera": self.camera,
                "notes": list(self.notes),
                "noise": [_table(n) for n in self.noise],
            }
        )

    @classmethod
    def from_toml(cls, text: str, source: str = "noise") -> "Calibrated":
        """Read what `to_toml` wrote. Raises InputError that names `source`."""
        table = parse_toml(text, source)
        if table.get("kind") != KIND or table.get("version") != VERSION:
            raise InputError(f"{source}: is no noise file, as `jaxisp calibrate` writes it")
        try:
            noise = tuple(_noise(n) for n in table["noise"])
            if not noise:
                raise ValueError("no noise")
            return cls(str(table["camera"]), noise, tuple(map(str, table.get("notes", ()))))
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{source}: is a damaged noise file ({short(error)})") from None

    def save(self, path: PathLike) -> None:
        """Write the file, whole or not at all."""
        write_text(path, self.to_toml())

    @classmethod
    def load(cls, path: PathLike) -> "Calibrated":
        """Read a file. Raises InputError where it is missing or wrong."""
        return cls.from_toml(read_text(path), str(Path(path)))


def _between(a: float, b: float, share: float) -> float:
    if a > 0 and b > 0:
        return math.exp((1 - share) * math.log(a) + share * math.log(b))
    return (1 - share) * a + share * b


def _table(noise: Noise) -> dict[str, Any]:
    out: dict[str, Any] = {} if noise.iso is None else {"iso": noise.iso}
    out |= {"black": noise.black, "white": noise.white, "cfa": noise.cfa, "frames": list(noise.frames)}
    if noise.stated is not None:
        out["stated"] = list(noise.stated)
    out["shot_by_place"] = [list(map(float, f)) for f in noise.shot_by_place]
    return out | {"figures": {n: _figure(n, f) for n, f in noise.figures.items()}}


def _figure(name: str, figure: Figure) -> dict[str, Any]:
    return {"value": float(figure.value), "error": float(figure.error), "unit": FIGURES[name][0]}


def _number(value: Any) -> float:
    if not abs(value) <= sys.float_info.max:  # of integers, too
        raise ValueError(f"a number is {value}")
    return float(value)


def _measured(value: Any, error: Any) -> Figure:
    """A figure, whose error may be infinite."""
    return Figure(_number(value), math.inf if error == math.inf else _number(error))


def _noise(table: dict[str, Any]) -> Noise:
    figures = {n: _measured(f["value"], f["error"]) for n, f in table["figures"].items()}
    unknown = set(figures) - set(FIGURES)
    missing = {"shot", "read"} - set(figures)
    if unknown or missing:
        raise ValueError(f"figures {sorted(figures)}")
    stated = table.get("stated")
    iso = table.get("iso")
    return Noise(
        None if iso is None else _number(iso),
        figures,
        _number(table["black"]),
        _number(table["white"]),
        str(table["cfa"]),
        tuple(_measured(v, e) for v, e in table.get("shot_by_place", ())),
        None if stated is None else (_number(stated[0]), _number(stated[1])),
        tuple(map(int, table.get("frames", (0, 0)))),  # type: ignore[arg-type]
    )


def with_noise(recipe: RecipeLike, noise: Noise) -> Recipe:
    """The recipe with calibrated noise in the place of its own.

    All its stages of noise before demosaicking (or, without a mosaic, before encoding) go, with switches
    around them; the calibrated ones stand where the first was. The rest stays, to the bit.

    Raises:
        InputError: the recipe has no stage of noise in linear light.
    """
    recipe = find_recipe(recipe)
    own = [s.name for s in _in_light(recipe.chain) if s.fn.__name__ in NOISE_STAGES]
    if not own:
        raise InputError(f"recipe {recipe.name!r} has no stage of noise in linear light to replace")
    chain, params = noise.stages()
    place = stage("black_level", name=chain.name)  # holds the place while names of both would clash
    edited = recipe.insert(place, before=own[0]).without(*own).replace(chain.name, chain)
    values = {name: {f: getattr(v, f) for f in specs(type(v))} for name, v in params.items()}
    text = f"{recipe.description}; calibrated noise" + (f" of ISO {noise.iso:g}" if noise.iso else "")
    return dataclasses.replace(edited.override(**values), description=text)


def _in_light(chain: Chain) -> list[Stage]:
    """The stages up to demosaicking or encoding."""

    def ends(one: Stage) -> bool:
        return one.fn.__name__ == "srgb_oetf" or one.fn.__name__.startswith("demosaic")

    return list(itertools.takewhile(lambda one: not ends(one), chain.stages()))
