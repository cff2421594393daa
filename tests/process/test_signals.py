"""Ctrl-C, SIGTERM, SIGHUP: one line, 130, 143, 129, within two seconds; unfinished training is never 0."""

import os
import pty
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from experiments.abuse.stop import ENDINGS
from jaxisp.io import write_png
from jaxisp.process.signals import LINE


@pytest.fixture(autouse=True)
def a_terminal_can_be_lost():
    """Also where these tests run under nohup, whose children ignore that signal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", ENDINGS)
@pytest.mark.parametrize(
    "what",
    [
        "time.sleep(60)",
        'hashlib.pbkdf2_hmac("sha256", b"a", b"b", 10**9)',  # does not return to Python, as compilers
        """try:  # as libraries do
        time.sleep(60)
    except BaseException:
        raise RuntimeError from None""",
        """try:
        time.sleep(60)
    except BaseException:
        raise jaxisp.InputError("a.png: is damaged") from None""",
        """try:
        time.sleep(60)
    except BaseException:
        return 2  # as where one file of a batch is bad""",
    ],
)
def test_one_line_and_the_status(number, what):
    program = f"""
import hashlib, os, subprocess, sys, time
from jaxisp import __main__ as process
import jaxisp.cli
def busy(arguments):
    subprocess.Popen(["sh", "-c", f"sleep 0.2; kill -{int(number)} {{os.getpid()}}"])
    {what}
jaxisp.cli.listings.run_recipes = busy
sys.argv[1:] = ["recipes"]
from jaxisp.process import signals
signals.watch()
sys.exit(process.main())
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=20)
    assert (done.returncode, done.stderr, done.stdout) == (ENDINGS[number], LINE + "\n", "")


@pytest.mark.parametrize("number", ENDINGS)
def test_a_signal_that_comes_while_signals_are_taken(number):
    program = f"""
import os, signal
from jaxisp import __main__ as process
take = signal.signal
def at_once(taken, handler):
    take(taken, handler)
    if taken == {int(number)}:
        os.kill(os.getpid(), taken)
signal.signal = at_once
raise SystemExit(process.main())
"""
    done = subprocess.run(
        [sys.executable, "-c", program, "recipes"], capture_output=True, text=True, timeout=20
    )
    assert (done.returncode, done.stderr, done.stdout) == (ENDINGS[number], LINE + "\n", "")


@pytest.mark.parametrize("number", ENDINGS)
def test_nothing_is_raised_within_an_import(tmp_path, number):
    """An extension's beginning does not unwind: numpy's ended in SIGSEGV."""
    module = f"""
import os, pathlib, time
os.kill(os.getpid(), {int(number)})
try:
    time.sleep(0.3)
except BaseException:
    pathlib.Path("raised").touch()
    raise
pathlib.Path("imported").touch()
"""
    (tmp_path / "extension.py").write_text(module)
    program = """
import pathlib, sys, time
from jaxisp import __main__ as process
import jaxisp.cli
def load(arguments):
    import extension
    try:
        time.sleep(60)
    finally:
        pathlib.Path("unwound").touch()
jaxisp.cli.listings.run_recipes = load
raise SystemExit(process.main())
"""
    done = subprocess.run(
        [sys.executable, "-c", program, "recipes"], capture_output=True, text=True, timeout=20, cwd=tmp_path
    )
    assert (done.returncode, done.stderr, done.stdout) == (ENDINGS[number], LINE + "\n", "")
    assert {path.name for path in tmp_path.iterdir() if not path.suffix} >= {"imported", "unwound"}
    assert not (tmp_path / "raised").exists()


@pytest.mark.parametrize("number", ENDINGS)
def test_a_signal_before_signals_are_taken_is_told_after(number):
    program = f"""
import os
from jaxisp import __main__ as process
opened = process._open_streams
def at_once():
    os.kill(os.getpid(), {int(number)})
    opened()
process._open_streams = at_once
raise SystemExit(process.main())
"""
    done = subprocess.run(
        [sys.executable, "-c", program, "recipes"], capture_output=True, text=True, timeout=20
    )
    assert (done.returncode, done.stderr, done.stdout) == (ENDINGS[number], LINE + "\n", "")


@pytest.mark.parametrize(("words", "status"), [(["recipes", "awgn"], 0), (["recipes", "--nonsense"], 2)])
@pytest.mark.parametrize("number", ENDINGS)
def test_a_signal_after_all_is_done_changes_nothing(number, words, status):
    """Also while Python ends: what it holds is let go after its handlers of signals are."""
    program = f"""
import os, sys
class Last:
    kill, own = os.kill, os.getpid()
    def __del__(self):
        self.kill(self.own, {int(number)})
sys.modules["last"] = Last()
from jaxisp import __main__ as process
raise SystemExit(process.main())
"""
    done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, timeout=20)
    assert done.returncode == status and LINE not in done.stderr
    assert (done.stderr == "") == (status == 0) and ("gaussian_noise" in done.stdout) == (status == 0)


def test_under_nohup_a_lost_terminal_ends_nothing():
    program = """
import os, signal, sys
from jaxisp import __main__ as process
import jaxisp.cli
listed = jaxisp.cli.listings.run_recipes
def lose(arguments):
    os.kill(os.getpid(), signal.SIGHUP)
    return listed(arguments)
jaxisp.cli.listings.run_recipes = lose
raise SystemExit(process.main())
"""
    command = ["nohup", sys.executable, "-c", program, "recipes", "awgn"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20)
    assert (done.returncode, LINE in done.stderr) == (0, False) and "gaussian_noise" in done.stdout


def test_a_terminal_that_is_gone_takes_no_line(tmp_path):
    """Only the status tells: what is written to the terminal fails."""
    program = f"""
import fcntl, pathlib, termios, time
from jaxisp import __main__ as process
import jaxisp.cli
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
def wait(arguments):
    pathlib.Path({str(tmp_path / "runs")!r}).touch()
    time.sleep(60)
jaxisp.cli.listings.run_recipes = wait
raise SystemExit(process.main())
"""
    ours, its = pty.openpty()
    command = [sys.executable, "-c", program, "recipes"]
    process = subprocess.Popen(command, stdin=its, stdout=its, stderr=its, start_new_session=True)
    os.close(its)
    while not (tmp_path / "runs").exists():
        assert process.poll() is None
        time.sleep(0.05)
    os.close(ours)
    assert process.wait(timeout=20) == 129


@pytest.mark.parametrize(
    ("numbers", "flags", "status"),
    [
        ([signal.SIGTERM], (), 143),
        ([signal.SIGTERM], ("--stop-status", "75"), 75),
        ([signal.SIGHUP, signal.SIGHUP], (), 129),  # as from the system and from the shell
    ],
)
def test_training_that_is_not_finished_is_never_0(tmp_path, numbers, flags, status):
    (tmp_path / "in").mkdir()
    write_png(tmp_path / "in" / "p.png", np.zeros((24, 30, 3)))
    words = "--recipe awgn --model fast --steps 100000 --batch 1 --patch 12 --downsample 1 --validation 1"
    places = ["--clean", str(tmp_path / "in"), "-o", str(tmp_path / "run")]
    command = [sys.executable, "-m", "jaxisp", "train", *places]
    process = subprocess.Popen(
        [*command, *words.split(), "--log-every", "1", "--cpu-devices", "1", "--grace", "30", *flags],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    log = tmp_path / "run" / "log.csv"
    while not log.exists() or log.stat().st_size < 200:
        assert process.poll() is None
        time.sleep(0.05)
    for number in numbers:
        process.send_signal(number)
        time.sleep(0.01)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (status, LINE + "\n") and "continue with --resume" in out
    assert (tmp_path / "run" / "checkpoints" / "last").is_dir() and not (tmp_path / "run" / ".lock").exists()


def test_a_stop_status_of_0_is_refused(capsys):
    from jaxisp.cli import main

    with pytest.raises(SystemExit) as ended:
        main(["train", "-o", "run", "--stop-status", "0"])
    assert ended.value.code == 2 and "0 means that it is finished" in capsys.readouterr().err
