"""Runs: stopped and resumed to the same bits, killed, short of disk, two at once, over two processes."""

import contextlib
import csv
import dataclasses
import fcntl
import hashlib
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest
from orbax.checkpoint.checkpoint_manager import future
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.recipe import Recipe
from jaxisp.recipes import RECIPES, find_degradation
from jaxisp.testing import smooth_image
from jaxisp.train import TrainConfig, load_denoiser, train
from jaxisp.train.checkpoints import Checkpoints
from jaxisp.train.folder import begin, load_settings, settings_digest
from jaxisp.train.logs import Log, read_rows
from jaxisp.train.step import LOSSES

SMALL = {
    "recipe": "awgn", "model": "dncnn6", "model_options": {"depth": 3, "features": 16}, "steps": 4,
    "batch": 2, "patch": 12, "downsample": 1, "validation": 2, "warmup": 1, "log_every": 1,
    "checkpoint_every": 3,
}  # fmt: skip

SLURM_PORTS = 65536 - 4096


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clean")
    for i in range(3):
        Image.fromarray(np.uint8(255 * smooth_image((20, 24, 3), i))).save(folder / f"{i}.png")
    (folder / "broken.jpg").write_bytes(b"not a picture")
    return TrainConfig(clean=(str(folder),), **SMALL)


@pytest.fixture(scope="module")
def whole(config, tmp_path_factory):
    """A run that nothing interrupts."""
    return train(config, tmp_path_factory.mktemp("runs") / "whole")


@pytest.fixture(scope="module")
def stopped(config, whole):
    """The same run, interrupted after two steps."""
    handler = signal.getsignal(signal.SIGINT)
    result = train(config, whole.run.parent / "stopped", tick=interrupt_at(2))
    assert result.step == 2 and not result.finished
    assert signal.getsignal(signal.SIGINT) == handler
    return result.run


def interrupt_at(step):
    def tick(done, total, text):
        if "loss" in text and done == step:
            os.kill(os.getpid(), signal.SIGINT)

    return tick


def curve(run):
    return [(row["step"], row["loss"], row["grad_norm"], row["lr"]) for row in read_rows(run / "log.csv")]


def saved(run):
    """Steps of the checkpoints that there are, without cleaning up as a trainer does."""
    return Checkpoints(run, "a run", reading=True).steps()


def fingerprint(state):
    """A digest of every bit of a state, to compare runs by."""
    digest = hashlib.sha256()
    for path, leaf in jax.tree.leaves_with_path(state):
        digest.update(str(path).encode())
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()


def test_a_run_is_recorded(config, whole):
    assert whole.finished and whole.step == 4 and whole.devices.startswith("2 x ")
    assert TrainConfig.load(whole.run / "config.toml") == config
    assert Recipe.load(whole.run / "recipe.toml") == RECIPES["awgn"]()
    assert [row[0] for row in curve(whole.run)] == ["1", "2", "3", "4"]
    validations = read_rows(whole.run / "validation.csv")
    assert [v["step"] for v in validations] == ["3", "4"]
    assert whole.best["psnr"] == max(float(v["psnr"]) for v in validations)
    assert len(whole.skipped) == 1 and "broken.jpg" in whole.skipped[0][0]
    card = (whole.run / "MODEL_CARD.md").read_text()
    for fact in (
        "dncnn6",
        "`awgn`",
        "4 of 4 steps",
        "seed 0",
        "gaussian_noise",
        f"{whole.best['psnr']:.2f} dB",
    ):
        assert fact in card
    events = list((whole.run / "tensorboard").iterdir())
    assert any(b"train/loss" in e.read_bytes() and b"validation/psnr" in e.read_bytes() for e in events)


def test_metrics_go_to_a_callback_as_they_do_to_the_logs(config, tmp_path):
    seen = []
    run = tmp_path / "run"
    train(config, run, metrics=lambda step, values: seen.append((step, values)))
    for group, name in (("train", "log.csv"), ("validation", "validation.csv")):
        told = [(step, values) for step, values in seen if f"{group}/loss" in values]
        rows = read_rows(run / name)
        assert [step for step, _ in told] == [int(row["step"]) for row in rows]
        for (_, values), row in zip(told, rows):
            assert {f"{group}/{k}": float(v) for k, v in row.items() if k not in ("step", "epoch")} == values
    steps = [step for step, _ in seen]
    assert steps == sorted(steps)  # loggers refuse to go back


def test_a_callback_that_fails_ends_the_run_and_frees_its_folder(config, tmp_path):
    def fails(step, values):
        raise ConnectionError("no network")

    with pytest.raises(ConnectionError):
        train(config, tmp_path / "run", metrics=fails)
    assert train(config, tmp_path / "run", resume=True).finished


def test_a_mixture_trains_and_resumes_to_the_same_bits(config, tmp_path):
    mixed = dataclasses.replace(config, recipe="awgn=0.5,amwgn=0.25,clean=0.25")
    whole = train(mixed, tmp_path / "whole")
    train(mixed, tmp_path / "part", tick=interrupt_at(2))
    resumed = train(mixed, tmp_path / "part", resume=True)
    assert fingerprint(resumed.state) == fingerprint(whole.state)
    told, recipe = load_settings(tmp_path / "part")
    assert told == mixed and recipe.names == ("awgn", "amwgn", "clean")
    assert "50 % awgn, 25 % amwgn, 25 % clean" in (tmp_path / "part" / "MODEL_CARD.md").read_text()


def test_a_named_recipe_with_a_mosaic_trains_on_all_its_phases():
    phases = [find_degradation(n, phases=True).name for n in ("phone", "awgn", "phone-phases")]
    assert phases == ["phone-phases", "awgn", "phone-phases"]
    assert find_degradation("phone").name == "phone"
    assert find_degradation("phone=0.5,clean=0.5", phases=True).names == ("phone-phases", "clean")


def test_interrupted_and_resumed_is_the_uninterrupted_run(config, whole, stopped, tmp_path):
    run = shutil.copytree(stopped, tmp_path / "run")
    assert saved(run) == [2] and curve(run) == curve(whole.run)[:2]
    assert "stopped before its end" in (run / "MODEL_CARD.md").read_text()
    with (run / "log.csv").open("a") as file:  # rows of steps that were lost, and one cut off
        file.write("3,0,9.9,9.9,9.9,1\n4,0,")
    with pytest.raises(InputError, match="holds a run already"):
        train(config, run)
    rest = train(config, run, resume=True)
    assert rest.finished and fingerprint(rest.state) == fingerprint(whole.state)
    assert curve(run) == curve(whole.run)
    assert (run / "validation.csv").read_bytes() == (whole.run / "validation.csv").read_bytes()
    assert "stopped" not in (run / "MODEL_CARD.md").read_text()


def test_another_configuration_or_recipe_does_not_go_on(config, whole):
    for change, recipe, message in (
        ({"lr": 0.5}, None, "was begun with lr = 0.001"),
        ({}, RECIPES["amwgn"](), "another recipe"),
    ):
        with pytest.raises(InputError, match=message):
            train(dataclasses.replace(config, **change), whole.run, recipe=recipe, resume=True)


def test_a_finished_run_that_is_resumed_stays(config, whole):
    again = train(config, whole.run, resume=True)
    assert again.finished and fingerprint(again.state) == fingerprint(whole.state)


def test_a_run_whose_photographs_are_not_there_leaves_its_folder_free(config, tmp_path):
    with pytest.raises(InputError):
        train(dataclasses.replace(config, clean=(str(tmp_path / "nothing"),)), tmp_path / "run")
    assert not (tmp_path / "run" / "config.toml").exists()
    assert train(dataclasses.replace(config, steps=1), tmp_path / "run").finished


def test_two_runs_into_one_folder_are_refused(config, tmp_path):
    with (tmp_path / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another process is training"):
            train(config, tmp_path)


@contextlib.contextmanager
def largest_file(size):
    """No file of more bytes can be written."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_is_one_error_and_the_last_checkpoint_stands(config, stopped, tmp_path, capfd):
    run = shutil.copytree(stopped, tmp_path / "run")
    with largest_file(6000), pytest.raises(InputError, match=r"step 3 cannot be written.*step 2 is intact"):
        train(config, run, resume=True)
    assert not capfd.readouterr().err
    assert load_denoiser(run, "last")[1] == config and saved(run) == [2]


@pytest.mark.parametrize("what", [{"seed": 9}, {"light": "linear"}])
def test_settings_of_another_run_are_not_taken(config, stopped, tmp_path, what):
    run, other = shutil.copytree(stopped, tmp_path / "run"), dataclasses.replace(config, **what)
    other.save(run / "config.toml")
    with pytest.raises(InputError, match=r"no last checkpoint that can be read .*it is of another run"):
        load_denoiser(run, "last")
    with pytest.raises(InputError, match="it is of another run"):
        train(other, run, resume=True)


def test_a_disk_that_fills_up_within_a_checkpoint_is_one_error(whole, tmp_path, caplog, monkeypatch):
    async def fill_up():
        raise OSError("full")

    def save(step, args):
        (folder / f"{step}.orbax-checkpoint-tmp").mkdir()
        future.CommitFuture(fill_up()).result()  # orbax's thread logs it, too

    store, folder = Checkpoints(tmp_path, "a run"), tmp_path / "checkpoints" / "last"
    monkeypatch.setattr(store._managers["last"], "save", save)
    with pytest.raises(InputError, match=r"step 4 cannot be written \(full\); there is none yet"):
        store.save(whole.state, None)
    assert not list(folder.iterdir()) and not caplog.records


def test_a_log_on_a_full_disk_is_one_error(tmp_path, capfd, monkeypatch):
    row = {"step": 1, "epoch": 0, "loss": 1.0, "grad_norm": 1.0, "lr": 1.0, "images_per_second": 1.0}
    log, events = Log(tmp_path, 0), next((tmp_path / "tensorboard").iterdir())
    log.steps([row])
    assert b"train/loss" in events.read_bytes()  # written before the call returns
    file = log._events._writer._py_recordio_writer._writer
    with open("/dev/full", "wb") as full:
        os.dup2(full.fileno(), file.fileno())
        monkeypatch.setattr("tensorboardX.record_writer.open_file", lambda path: full)
        for call in (lambda: log.steps([row]), log.close, lambda: Log(tmp_path, 0)):
            with pytest.raises(InputError, match="tensorboard: cannot be written: no space left"):
                call()
        with pytest.raises(OSError):
            full.close()  # what could not be written is still with it
    assert not capfd.readouterr().err


def test_reading_a_run_leaves_what_its_trainer_is_writing(whole, stopped, tmp_path):
    run = shutil.copytree(stopped, tmp_path / "run")
    written = run / "checkpoints" / "last" / "9.orbax-checkpoint-tmp"
    written.mkdir()
    load_denoiser(run, "last")
    assert written.is_dir()
    # as a trainer, before which whoever was writing is dead
    Checkpoints(run, "a run").save(whole.state, None)
    assert not written.exists()


def test_reading_a_run_without_checkpoints_makes_none(stopped, tmp_path):
    run = shutil.copytree(stopped, tmp_path / "run")
    shutil.rmtree(run / "checkpoints")
    with pytest.raises(InputError, match="no last checkpoint that can be read"):
        load_denoiser(run)
    assert not (run / "checkpoints").exists()


def test_a_loss_that_is_no_number_stops_before_a_checkpoint(config, tmp_path, monkeypatch):
    monkeypatch.setitem(LOSSES, "l2", lambda x: x * np.nan)
    with pytest.raises(InputError, match="the loss is nan at step 1"):
        train(dataclasses.replace(config, loss="l2"), tmp_path)
    assert not saved(tmp_path)


def test_a_damaged_checkpoint_gives_way_to_the_one_before(config, whole):
    run = whole.run.parent / "damaged"
    shutil.copytree(whole.run, run)
    assert saved(run) == [3, 4]
    shutil.rmtree(run / "checkpoints" / "last" / "4" / "state")
    rest = train(config, run, resume=True)
    assert fingerprint(rest.state) == fingerprint(whole.state)


@pytest.mark.parametrize("which", ["last", "best"])
def test_a_damaged_checkpoint_is_written_again(config, whole, tmp_path, which):
    run = shutil.copytree(whole.run, tmp_path / "run")
    (place,) = [p for p in (run / "checkpoints" / which).iterdir() if p.name == "4" or which == "best"]
    file = max((p for p in place.rglob("*") if p.is_file()), key=lambda p: p.stat().st_size)
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    train(config, run, resume=True)
    store = Checkpoints(run, settings_digest(config, load_settings(run)[1]), reading=True)
    assert store.steps() == [3, 4] and int(store.restore(whole.state).step) == 4
    assert which == "last" or store.best is None or store.best[0] <= 4
    store.close()


def test_numbers_that_are_whole_are_read_back(config, tmp_path):
    told = dataclasses.replace(config, ema=0, clip_norm=1, weight_decay=0, steps=1)
    assert train(told, tmp_path / "run").finished
    assert load_denoiser(tmp_path / "run", "last")[1] == told


KILLED = """
import os, signal, sys
from jaxisp.train import TrainConfig, train
rename = os.rename
def killing(source, target, **options):  # a checkpoint takes its name by it
    if os.path.basename(str(target)) == "3" and "last" in str(target):
        os.kill(os.getpid(), signal.SIGKILL)
    rename(source, target, **options)
os.rename = killing
train(TrainConfig.load(sys.argv[1]), sys.argv[2], resume=True)
"""


def test_a_kill_within_a_checkpoint_loses_no_good_one(config, whole, stopped, tmp_path):
    run = shutil.copytree(stopped, tmp_path / "run")
    config.save(tmp_path / "config.toml")
    done = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path / "config.toml", run], capture_output=True, text=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert any("3" in p.name for p in (run / "checkpoints" / "last").iterdir())  # it was being written
    assert saved(run) == [2]
    rest = train(config, run, resume=True)
    assert fingerprint(rest.state) == fingerprint(whole.state)
    assert curve(run) == curve(whole.run)


@pytest.mark.slow
def test_two_processes_give_the_curve_of_one(config, whole, tmp_path):
    """One is told where to meet, the other finds it in what Slurm sets."""
    run, port = tmp_path / "run", slurm_port()
    run.mkdir()
    begin(run, config, RECIPES["awgn"]())
    command = [sys.executable, "-m", "jaxisp", "train", "-o", run, "--resume", "--cpu-devices", "1"]
    told = ["--coordinator", f"localhost:{port}", "--processes", "2", "--process-id", "0"]
    slurm = {
        "SLURM_JOB_ID": str(port - SLURM_PORTS), "SLURM_STEP_NODELIST": "localhost", "SLURM_NTASKS": "2",
        "SLURM_PROCID": "1", "SLURM_LOCALID": "0", "SLURM_STEP_NUM_NODES": "2",
    }  # fmt: skip
    processes = [
        subprocess.Popen(
            [*command, *flags], env={**os.environ, "XLA_FLAGS": "", **more},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for flags, more in ((told, {}), (["--coordinator", "auto"], slurm))
    ]  # fmt: skip
    outputs = [p.communicate(timeout=180) for p in processes]
    assert [p.returncode for p in processes] == [0, 0], outputs
    assert all("on 2 x " in out for out, _ in outputs)
    got, wanted = (np.array(curve(r), float) for r in (run, whole.run))
    np.testing.assert_allclose(got[:, 1], wanted[:, 1], rtol=2e-5)
    with (run / "validation.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2


def slurm_port():
    """A free port among those that JAX picks from by Slurm's number of the job."""
    for port in np.random.default_rng(os.getpid()).integers(SLURM_PORTS, 65536, 50):
        with socket.socket() as s, contextlib.suppress(OSError):
            s.bind(("localhost", int(port)))
            return int(port)
    raise AssertionError("no free port")


def test_a_run_denoises(config, whole, rng):
    image = rng.random((15, 21, 3), np.float32)
    outputs = {}
    for which in ("best", "last"):
        denoiser, read = load_denoiser(whole.run, which)
        outputs[which] = denoiser(image)
        assert read == config and outputs[which].shape == image.shape
        assert outputs[which].min() >= 0 and outputs[which].max() <= 1
    np.testing.assert_array_equal(load_denoiser(whole.run, "last")[0](image), outputs["last"])
    with pytest.raises(InputError, match="holds no run"):
        load_denoiser(whole.run / "checkpoints")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('clean = ["x"]', "says no recipe"),
        ('clean = ["x"]\nrecipe = "awgn"\nlearning = 1', "no 'learning'"),
        ('clean = ["x"]\nrecipe = "awgn"\nsteps = "many"', "steps = 'many': expected int"),
        ('clean = ["x"]\nrecipe = "awgn"\nema = 1', "ema = 1.0"),
        ('clean = ["x"]\nrecipe = "awgn"\nloss = "l3"', "expected one of l1"),
    ],
)
def test_a_bad_configuration_is_named(tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(InputError, match=rf"c\.toml: .*{message}"):
        TrainConfig.load(tmp_path / "c.toml")
