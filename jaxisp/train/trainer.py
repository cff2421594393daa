"""A training run from its configuration: data, steps, checkpoints, log, validation, model card."""

import contextlib
import dataclasses
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from flax import nnx
from jax.experimental import multihost_utils

from jaxisp.data.clean import CleanImages, load_clean
from jaxisp.data.procedural import drawn_images
from jaxisp.data.sources import CleanPatches, degrade_key
from jaxisp.errors import InputError
from jaxisp.io.files import filled_folder
from jaxisp.io.locks import locked
from jaxisp.mixture import Degradation, check_runs
from jaxisp.models import count_parameters, load_weights, make_model
from jaxisp.process import signals
from jaxisp.recipes import RecipeLike, find_degradation
from jaxisp.shown import brief
from jaxisp.train.checkpoints import Checkpoints
from jaxisp.train.config import TrainConfig
from jaxisp.train.devices import make_mesh, replicate, spread, spread_pairs
from jaxisp.train.folder import POOL, begin, check_folder, settings_digest, write_card
from jaxisp.train.logs import Log
from jaxisp.train.optimizer import make_optimizer, schedule
from jaxisp.train.pool import PairPool
from jaxisp.train.step import State, init_state, make_step
from jaxisp.train.target import pair_maker
from jaxisp.train.validation import make_validation

Tick = Callable[[int, int, str], Any]
Metrics = Callable[[int, dict[str, float]], Any]
"""`metrics(step, values)`: how a step or a validation went, for a logger of the user's own."""


@dataclasses.dataclass(repr=False)
class TrainResult:
    """What a run came to.

    Args:
        run: its folder.
        step: updates done; `finished` says whether all are.
        loss: of the last step; NaN where none was done.
        validation: the last one, {"loss", "psnr", "psnr_in"}, or None.
        best: {"step", "psnr"} of the best one, or None.
        images_per_second: over this call without its first interval, which compiles; None if that was all.
        skipped: (file, reason) of photographs that could not be used.
        state: after the last step.
    """

    __repr__ = brief

    run: Path
    step: int
    finished: bool
    loss: float
    validation: dict[str, float] | None
    best: dict[str, float] | None
    parameters: int
    devices: str
    images_per_second: float | None
    seconds: float
    skipped: tuple[tuple[str, str], ...]
    state: State

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        table = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "state"}
        table["skipped"] = [{"file": name, "reason": reason} for name, reason in self.skipped]
        return {**table, "run": str(self.run), "loss": None if np.isnan(self.loss) else self.loss}


def train(
    config: TrainConfig,
    run: str | Path,
    *,
    recipe: RecipeLike | None = None,
    resume: bool = False,
    tick: Tick = lambda done, total, text: None,
    metrics: Metrics = lambda step, values: None,
) -> TrainResult:
    """Train a denoiser on pairs that are degraded on the fly.

    The patches, the degradation and the updates of a step follow from the configuration and the step's
    number alone, so a run that is stopped and resumed ends with the bits of one that was not. SIGINT,
    SIGTERM and SIGHUP let the step end, write a checkpoint and return.

    Args:
        config: everything but the place.
        run: a folder for checkpoints, log and model card; with several processes, one that all share.
        recipe: what `config.recipe` names, as a recipe, a mixture, a chain, a name or a TOML file, used as it
            is; looked up unless given.
        resume: go on from the last checkpoint in the folder (from the start where there is none).
        tick: called with (done, total, text).
        metrics: called with (step, values), in the order of the steps and by process 0 alone. Each step has
            `train/loss`, `train/grad_norm`, `train/lr` and `train/images_per_second`, given every
            `config.log_every` steps for those since the last time; each validation has `validation/loss`,
            `validation/psnr` and `validation/psnr_in`. What it raises ends the run.

    Raises:
        InputError: the recipe cannot run on photographs, the folder holds a run and `resume` is false,
            another process trains into it, no photograph can be used, the disk is full, or the loss is no
            longer finite.
    """
    run = Path(run)
    if recipe is None:
        asked = find_degradation(config.recipe, phases=config.phases)
    else:
        asked = find_degradation(recipe)
    check_runs(asked)
    lead = jax.process_index() == 0
    with contextlib.ExitStack() as stack:
        if lead:
            stack.enter_context(filled_folder(run))
            stack.enter_context(locked(run, doing="training"))
        signals = stack.enter_context(_Signals())
        if lead:
            check_folder(run, config, asked, resume=resume)
        return _Run(config, run, asked, lead, signals, tick, metrics).train()


class _Run:
    """One call of `train`."""

    def __init__(
        self,
        config: TrainConfig,
        run: Path,
        recipe: Degradation,
        lead: bool,
        signals: "_Signals",
        tick: Tick,
        metrics: Metrics,
    ) -> None:
        self.config, self.run, self.recipe, self.lead = config, run, recipe, lead
        self.signals, self.tick, self.clock = signals, tick, time.perf_counter()
        self.metrics = metrics
        self.mesh = make_mesh(config.batch)
        self.model = build_model(config)
        images = CleanImages((), ())
        if config.clean or not config.drawn:
            images = load_clean(
                config.clean, patch=config.patch, downsample=config.downsample,
                per_image=config.per_image, seed=config.seed, tick=tick,
            )  # fmt: skip
        if config.drawn:
            images = images.joined(drawn_images(config.drawn, config.seed, max(256, config.patch)))
        self.images = images
        training, held_out = _split(images, config.held_out)
        self.source = CleanPatches(
            training, config.patch, per_image=config.per_image, seed=config.seed, fresh=config.fresh_crops
        )
        self.pairs = jax.jit(pair_maker(recipe, degrade_key(config.seed), config.target, self.mesh))
        self.validate = make_validation(self.model, self.pairs, config, held_out, self.mesh)
        epoch_steps = max(1, len(self.source) // config.batch)
        optimizer = make_optimizer(config, epoch_steps)
        self.lr = schedule(config, epoch_steps)
        self.step = make_step(
            self.model, recipe, optimizer, key=degrade_key(config.seed), loss=config.loss,
            ema=config.ema, forgets=not config.start, light=config.light, target=config.target,
            mesh=self.mesh,
        )  # fmt: skip
        if lead:
            begin(run, config, recipe)  # not before its photographs were found, and before all other files
        self.pool = self._make_pool() if config.pool else None
        self.checkpoints = Checkpoints(run, settings_digest(config, recipe), config.keep)
        fresh = replicate(self.mesh, init_state(self.model, optimizer, ema=config.ema))
        self.state = self.checkpoints.restore(fresh) if self.checkpoints.steps() else fresh
        self.checkpoints.begin(int(self.state.step))
        self.log = Log(run, int(self.state.step)) if lead else None
        self.waiting: list[tuple[int, dict[str, jax.Array]]] = []
        self.loss = float("nan")
        self.validation: dict[str, float] | None = None
        self.rate = _Rate(config.batch)

    def train(self) -> TrainResult:
        done, config = int(self.state.step), self.config
        self.rate.start(done)
        while done < config.steps and not self._stopping(done):
            self.state, metrics = self.step(self.state, self._batch(done), done * config.batch)
            done += 1
            self.waiting.append((done, metrics))
            if done % config.log_every == 0:
                self._flush()
            if done % config.checkpoint_every == 0 or done == config.steps:
                self._save(validate=True)
        if done % config.checkpoint_every and done < config.steps:
            self._save(validate=False)
        return self._finish(done)

    def _make_pool(self) -> PairPool:
        if jax.process_count() > 1:
            raise InputError("a pool is made and read by one process: leave it out with several")
        config = self.config

        def make(indices: range) -> tuple[jax.Array, jax.Array]:
            clean = spread(self.mesh, self.source, indices)
            return self.pairs(clean, np.arange(indices.start, indices.stop, dtype=np.int32))

        return PairPool(
            self.run / POOL, settings_digest(config, self.recipe), config.patch, config.pool, make,
            seed=config.seed, batch=config.batch, tick=self.tick,
        )  # fmt: skip

    def _batch(self, done: int) -> Any:
        first = done * self.config.batch
        indices = range(first, first + self.config.batch)
        if self.pool is not None:
            return spread_pairs(self.mesh, self.pool, indices)
        return spread(self.mesh, self.source, indices)

    def _stopping(self, done: int) -> bool:
        """Whether a signal came; several processes agree on it where they log."""
        if jax.process_count() == 1:
            return self.signals.came
        if done % self.config.log_every:
            return False
        return bool(multihost_utils.process_allgather(np.asarray(self.signals.came)).any())

    def _flush(self) -> None:
        """Fetch the metrics of the steps since the last time, and log them."""
        if not self.waiting:
            return
        values = [(step, jax.device_get(metrics)) for step, metrics in self.waiting]
        self.waiting = []
        rate = self.rate.lap(values[-1][0])
        rows = [
            {
                "step": step,
                "epoch": (step - 1) * self.config.batch // len(self.pool or self.source),
                "loss": float(m["loss"]),
                "grad_norm": float(m["grad_norm"]),
                "lr": float(self.lr(step - 1)),
                "images_per_second": round(rate, 2),
            }
            for step, m in values
        ]
        for row in rows:
            if not np.isfinite(row["loss"]):
                raise InputError(
                    f"{self.run}: the loss is {row['loss']} at step {row['step']}; lower the learning rate "
                    f"({self.config.lr:g}) or resume from the last checkpoint"
                )
        self.loss = rows[-1]["loss"]
        if self.log:
            self.log.steps(rows)
            for row in rows:
                self.metrics(int(row["step"]), _named("train", row))
        mean = np.mean([row["loss"] for row in rows])
        self.tick(values[-1][0], self.config.steps, f"loss {mean:.5f}, {rate:.0f} images/s")

    def _save(self, *, validate: bool) -> None:
        self._flush()
        psnr = None
        if validate:
            found = self.validate(self.state)
            self.validation, psnr = found, found["psnr"]
            if self.log:
                self.log.validation({"step": int(self.state.step), **found})
                self.metrics(int(self.state.step), _named("validation", found))
        self.checkpoints.save(self.state, psnr)
        self.rate.pause()

    def _finish(self, done: int) -> TrainResult:
        best = self.checkpoints.best
        device = self.mesh.devices.flat[0]
        result = TrainResult(
            run=self.run,
            step=done,
            finished=done >= self.config.steps,
            loss=self.loss,
            validation=self.validation,
            best=None if best is None else {"step": best[0], "psnr": best[1]},
            parameters=count_parameters(self.model),
            devices=f"{self.mesh.size} x {device.device_kind}",
            images_per_second=round(self.rate.mean, 2) or None,
            seconds=round(time.perf_counter() - self.clock, 2),
            skipped=self.images.skipped,
            state=self.state,
        )
        self.checkpoints.close()
        if self.log:
            self.log.close()
            count, drawn = len(self.images.names) - self.config.drawn, self.config.drawn
            told = [f"{count} files of {', '.join(self.config.clean)}"] if count else []
            data = ", and ".join([*told, f"{drawn} drawn"] if drawn else told)
            write_card(self.run, self.config, self.recipe, result.as_dict(), data)
        return result


def _named(group: str, row: dict[str, float]) -> dict[str, float]:
    return {f"{group}/{name}": value for name, value in row.items() if name not in ("step", "epoch")}


def build_model(config: TrainConfig) -> nnx.Module:
    """The network that a run begins with: of fresh weights, or of those of `config.start`."""
    if not config.start:
        return _make_model(config)
    model = model_shapes(config)
    load_weights(model, config.start)
    return model


def model_shapes(config: TrainConfig) -> nnx.Module:
    """The network of a run without weights: shapes stand for them, so that none are drawn."""
    return nnx.eval_shape(lambda: _make_model(config))


def _make_model(config: TrainConfig) -> nnx.Module:
    options = dict(config.model_options)
    if config.bf16:
        options["dtype"] = jax.numpy.bfloat16
    return make_model(config.model, seed=config.seed, **options)


def _split(images: CleanImages, held_out: int) -> tuple[CleanImages, CleanImages]:
    """Photographs to train on and to validate on; a lone one is both."""
    count = len(images.images)
    wanted = max(1, count // 10) if held_out < 0 else held_out
    if count == 1 or wanted == 0:
        return images, images
    if wanted >= count:
        raise InputError(f"held_out = {wanted}: there are only {count} photographs")
    return images.split(wanted)


class _Rate:
    """Images a second, of steps alone: compiling, validating and saving left out."""

    def __init__(self, batch: int) -> None:
        self.batch, self.steps, self.seconds, self.first = batch, 0, 0.0, True

    def start(self, step: int) -> None:
        self.step, self.clock = step, time.perf_counter()

    def lap(self, step: int) -> float:
        count, seconds = step - self.step, time.perf_counter() - self.clock
        if not self.first:
            self.steps, self.seconds = self.steps + count, self.seconds + seconds
        self.first = False
        self.start(step)
        return count * self.batch / max(seconds, 1e-9)

    def pause(self) -> None:
        self.clock = time.perf_counter()

    @property
    def mean(self) -> float:
        return self.steps * self.batch / self.seconds if self.seconds else 0.0


class _Signals:
    """Takes a signal that ends a process as a wish to stop; a second one does what it did before,
    but that of a lost terminal, which comes twice."""

    came = False

    def __enter__(self) -> "_Signals":
        self._before: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            for number in signals.ending():
                self._before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, frame: Any) -> None:
        self.came = True
        if not signals.is_lost_terminal(number):
            signal.signal(number, self._before[number])

    def __exit__(self, *_: Any) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
