"""Clean+noisy pairs: the base that is fitted, and the problem whose errors are differences of statistics."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.gap import prepare
from jaxisp.gap.effects import CLEAN_NOISY, Move
from jaxisp.gap.model import Coordinate, Model, build, plain_freedom
from jaxisp.gap.residual import BORDER, Pairs, Problem, start_matrix, to_steps
from jaxisp.gap.solve import fit
from jaxisp.gap.statistics import features, normalised_regressors, tolerances
from jaxisp.gap.which import Split, Tick
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.pipeline import Chain, Params, Stage, stage
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.choice import DEMOSAICKERS, Demosaicking
from jaxisp.stages.jpeg import JpegTables

_REPLICATES = 4
_TYPICAL = np.array([[0.6, -0.5, -0.1], [-0.25, 0.5, -0.25], [0.0, -0.6, 0.6]])
"""What a phone's colour matrix has beside the identity; its rows keep white."""
_NOISE = (
    Coordinate("balanced_noise", Move("shot", 4e-4, 0, 0.1)),
    Coordinate("balanced_noise", Move("read", 3e-3, 0, 0.2)),
    Coordinate("balanced_noise", Move("red_gain", 0.3, 0.2, 8)),
    Coordinate("balanced_noise", Move("blue_gain", 0.3, 0.2, 8)),
)


class StatisticsProblem:
    """Statistics of the real pictures against those of simulated ones; has what `Problem` has.

    The noise of a simulated picture is drawn from one key a pair, whatever the parameters, so that a change
    of statistics is the parameters' doing.
    """

    def __init__(self, model: Model, pairs: Pairs, noise_free: np.ndarray, seed: int) -> None:
        self.model, self.pairs, self.seed = model, pairs, seed
        self.inner = (slice(None), slice(BORDER, -BORDER), slice(BORDER, -BORDER))
        self.mask = jnp.asarray(pairs.mask[self.inner], jnp.float32)
        self.base_picture = jnp.asarray(noise_free[self.inner])
        self.target = to_steps(pairs.pictures[self.inner])
        self.weight = np.sqrt(np.broadcast_to(np.asarray(self.mask)[..., None], self.target.shape))
        self._maps = tuple(normalised_regressors(self.base_picture, self.mask, c) for c in range(3))
        self.real = self.measured(self.target)
        self.unit = tolerances()
        self.move_to(np.zeros(len(model.coordinates)))

    def keys(self, replicate: int = 0) -> jax.Array:
        root = jax.random.fold_in(jax.random.key(self.seed), replicate)
        return jax.vmap(lambda i: jax.random.fold_in(root, i))(jnp.arange(len(self.pairs.names)))

    def rendered(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, H, W, 3) encoded, noise and all."""
        return self.model.render(z, self.pairs.light, self.keys(replicate))

    def picture(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        return to_steps(self.rendered(z, replicate)[self.inner])

    def simulated(self, z: np.ndarray, replicate: int = 0) -> np.ndarray:
        """(N, F) statistics of a simulated set."""
        return self.measured(self.picture(z, replicate))

    def measured(self, pictures: np.ndarray) -> np.ndarray:
        """(N, F) statistics of pictures in steps, their border cut off."""
        found = features(jnp.asarray(pictures), self.base_picture, self.mask, self._maps)
        return np.asarray(found, float)

    def set_unit(self) -> np.ndarray:
        """Take the scatter from draw to draw into the unit of each statistic; returns the (N,) floor."""
        draws = np.stack([self.simulated(self.z, k) for k in range(1, 1 + _REPLICATES)])
        scatter = draws.std(0, ddof=1)
        self.unit = np.sqrt(tolerances() ** 2 + 2 * (scatter**2).mean(0))
        self.move_to(self.z)
        differences = (draws - self.simulated(self.z)) / self.unit
        return (differences**2).mean((0, 2))

    def units(self, z: np.ndarray) -> np.ndarray:
        """(N, F) squared differences, whose mean over F is a pair's error."""
        return ((self.real - self.simulated(z)) / self.unit) ** 2

    def errors(self, z: np.ndarray) -> np.ndarray:
        return self.units(z).mean(1)

    def move_to(self, z: np.ndarray) -> None:
        self.z = np.asarray(z, float)
        self._simulated = self.simulated(self.z)
        self.difference = (self.real - self._simulated) / self.unit
        self.columns: dict[int, np.ndarray] = {}

    @property
    def residual(self) -> np.ndarray:
        return (self.target - np.asarray(self.base_picture)) * self.weight

    @property
    def current(self) -> np.ndarray:
        return np.asarray(self.base_picture)

    def compute(self, which: Sequence[int]) -> None:
        for i in set(which) - set(self.columns):
            moved, step = self.model.probe(self.z, i)
            self.columns[i] = (self.simulated(moved) - self._simulated) / self.unit / step

    def normal(self, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        stacked = np.stack([self.columns[i] for i in which], 1)
        count = stacked.shape[-1]
        return stacked @ stacked.transpose(0, 2, 1) / count, np.einsum(
            "nkf,nf->nk", stacked, self.difference
        ) / count


def clean_problem(
    loaded: Sequence[Loaded], exclude: Sequence[str], seed: int, tick: Tick
) -> tuple[StatisticsProblem, Split, dict[str, float], list[str], np.ndarray]:
    """The base fitted to clean+noisy pairs: the mean by pixels, then the noise by its statistics."""
    from jaxisp.gap.diagnose import halves

    pairs = _pairs(loaded)
    split = halves(len(loaded))
    effects = prepare.candidates(CLEAN_NOISY, exclude)
    tick(0, 3, "fitting the base")
    chain, params = _plain(loaded[0].jpeg)
    matrix = start_matrix(np.asarray(pairs.light), pairs.pictures, pairs.mask)
    params["color_matrix"] = ColorMatrix(matrix=np.asarray(np.clip(matrix, -4, 4), np.float32))
    free = plain_freedom()
    mean_model = build(chain.without("balanced_noise", chain.nodes[-1].name), params, {}, free, [])
    still = Problem(mean_model, pairs)
    fit(still, mean_model.base_indices, split.fit, steps=6)
    still.weigh(still.robust_weights())
    fit(still, mean_model.base_indices, split.fit, steps=2)
    noise_free = to_steps(mean_model.render(still.z, pairs.light))
    shared = params | mean_model.moved(still.z).shared
    model = build(chain, shared, {}, (*_NOISE, *free), effects, keep_file=True)
    problem = StatisticsProblem(model, pairs, noise_free, seed)
    tick(0, 3, "fitting the noise")
    problem.model = fit_noise(problem, split)
    problem.move_to(np.zeros(len(problem.z)))
    floors = problem.set_unit()
    absorbed = dict.fromkeys(
        ("tone_curve", "color_matrix", "white_balance", "black_level_offset", "noise_level"), 0.0
    )
    stated = {"jpeg_quantization"} if loaded[0].jpeg is not None else set()
    if loaded[0].jpeg is not None and loaded[0].jpeg.subsampling != "4:4:4":
        stated.add("chroma_subsampling")
    offered = [e.name for e in effects if e.name not in stated and e.name not in absorbed]
    return problem, split, absorbed, offered, floors


def fit_noise(problem: StatisticsProblem, split: Split) -> Model:
    """The demosaicker, the sensor's own primaries and the noise that explain the statistics best, one after
    another, and then all that is free in the base."""
    noise = list(range(len(_NOISE)))

    def tried(change: Params, steps: int) -> tuple[float, Model]:
        start = problem.model
        problem.model = dataclasses.replace(start, shared=start.shared | change)
        problem.move_to(np.zeros(len(problem.z)))
        error = fit(problem, noise, split.fit, steps=steps)
        result = error, problem.model.moved(problem.z)
        problem.model = start
        return result

    own = np.asarray(problem.model.shared["color_matrix"].matrix)
    problem.model = tried(_primaries(own, 0.6), 4)[1]
    for choices in (
        [{"demosaicking": Demosaicking(shares=row)} for row in np.eye(len(DEMOSAICKERS), dtype=np.float32)],
        [_primaries(own, share) for share in (0.0, 0.3, 0.6, 1.0, 1.4)],
    ):
        problem.model = min((tried(change, 2) for change in choices), key=lambda f: f[0])[1]
    problem.move_to(np.zeros(len(problem.z)))
    problem.set_unit()
    fit(problem, problem.model.base_indices, split.fit, steps=4)
    return problem.model.moved(problem.z)


def _primaries(matrix: np.ndarray, share: float) -> Params:
    """The scene seen in a sensor's primaries, and the matrix that undoes that and then does its own.

    Which matrix a camera uses cannot be told from its picture, but how it mixes the noise of the colours can.
    """
    mixing = np.eye(3) + share * _TYPICAL
    before, after = np.linalg.inv(mixing), matrix @ mixing
    return {
        "primaries": ColorMatrix(matrix=np.asarray(np.clip(before, -4, 4), np.float32)),
        "color_matrix": ColorMatrix(matrix=np.asarray(np.clip(after, -4, 4), np.float32)),
    }


def _pairs(loaded: Sequence[Loaded]) -> Pairs:
    loaded = list({p.name: p for p in loaded}.values())
    crops = prepare.common_crop(loaded)
    clean = np.stack([_linear(p)[c] for p, c in zip(loaded, crops)])
    pictures = np.stack([p.picture[c] for p, c in zip(loaded, crops)]).astype(np.float32)
    pictures = np.stack([prepare.laid_on(s, p) for s, p in zip(clean, pictures)])
    names = tuple(p.name for p in loaded)
    return prepare.in_halves(
        Pairs(names, jnp.asarray(clean, jnp.float32), pictures, prepare.usable(pictures))
    )


def _linear(pair: Loaded) -> np.ndarray:
    clean = np.asarray(pair.clean, np.float32)
    if pair.settings.clean_encoding == "linear":
        return clean
    return np.where(clean <= 0.04045, clean / 12.92, ((clean + 0.055) / 1.055) ** 2.4)


def _plain(file: Jpeg | None, cfa: str = "RGGB") -> tuple[Chain, Params]:
    """Scene to picture: mosaic, noise, demosaicking, one matrix, sRGB, one curve, the file's compression."""
    nodes: list[Any] = [
        Stage(stage("color_matrix").fn, "primaries"),
        stage("mosaic", cfa=cfa),
        Stage(stage("black_level").fn, "black_level_offset"),
        stage("balanced_noise", cfa=cfa),
        stage("demosaicking", cfa=cfa),
        stage("color_matrix"),
        stage("srgb_oetf"),
        Stage(stage("spline_curve").fn, "tone_curve"),
        stage("rounding"),
    ]
    tables: Params = {}
    if file is not None and file.subsampling in ("4:4:4", "4:2:2", "4:2:0"):
        encoder = Stage(
            stage("jpeg_tables").fn, "file", stage("jpeg_tables", subsampling=file.subsampling).static
        )
        nodes[-1] = encoder
        luma, chroma = (np.asarray(t, np.float32) for t in (file.luma_table, file.chroma_table))
        tables = {"file": JpegTables(luma_table=luma, chroma_table=chroma)}
    chain = Chain(tuple(nodes), "plain")
    return chain, chain.init() | tables
