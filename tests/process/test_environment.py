"""Environment variables that do not let JAX compute are one line; odd surroundings are none."""

import os
import subprocess
import sys

import jax
import pytest

from jaxisp.cli import main
from jaxisp.errors import InputError
from jaxisp.io import write_png
from jaxisp.process import cache, environment
from jaxisp.testing import smooth_image


@pytest.fixture
def picture(tmp_path):
    (tmp_path / "é").mkdir()
    write_png(tmp_path / "é" / "p.png", smooth_image((24, 30, 3)))
    return tmp_path / "é" / "p.png"


def call(*words, **variables):
    own = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "HOME")}
    return subprocess.run(
        [sys.executable, "-m", "jaxisp", *map(str, words)],
        capture_output=True, text=True, env={**own, **variables}, timeout=60,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        ("--nonsense", "Unknown flag in XLA_FLAGS: --nonsense"),
        ("--xla_dump_hlo_as_text=perhaps", "xla_dump_hlo_as_text=perhaps: "),
        ("", None),
        ("--xla_force_host_platform_device_count=2", None),
    ],
)
def test_flags_that_xla_refuses(monkeypatch, tmp_path, flags, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "numpy.py").write_text("raise RuntimeError")  # is not what is imported
    monkeypatch.setenv("XLA_FLAGS", flags)
    if told is None:
        environment.check_environment()
        return
    with pytest.raises(InputError, match=told) as caught:
        environment.check_environment()
    assert str(caught.value).startswith(f"XLA refuses XLA_FLAGS={flags}: ") and "\n" not in str(caught.value)


def test_a_variable_that_jax_refuses():
    done = call("recipes", JAX_ENABLE_X64="perhaps")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("jaxisp: JAX refuses") and "JAX_ENABLE_X64" in done.stderr


def test_a_platform_that_is_not_there(picture, tmp_path):
    done = call("degrade", picture, "-o", tmp_path / "out", "--recipe", "awgn", JAX_PLATFORMS="nonsense")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("jaxisp: JAX finds no device to compute on (JAX_PLATFORMS=nonsense)")


def test_other_errors_are_not_taken_for_it(monkeypatch):
    def broken(arguments):
        raise RuntimeError("of another kind")

    monkeypatch.setattr("jaxisp.cli.listings.run_recipes", broken)
    with pytest.raises(RuntimeError, match="of another kind"):
        main(["recipes"])

    def none():
        raise AssertionError

    monkeypatch.setattr(jax, "devices", none)
    assert main(["recipes"]) == 2


def test_places_that_are_missing_and_a_terminal_of_nothing(picture, tmp_path):
    """No home, no temporary folder, no place for programs, ASCII, no columns: nothing is said of it."""
    done = call(
        "degrade", picture, "-o", tmp_path / "é" / "out", "--recipe", "awgn",
        TMPDIR="/nonexistent", HOME="/dev/null", JAX_COMPILATION_CACHE_DIR="/proc/x", COLUMNS="0", LC_ALL="C",
        PYTHONIOENCODING="ascii", JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0",
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "") and r"\xe9" in done.stdout
    assert len(list((tmp_path / "é" / "out").iterdir())) == 4


def test_a_name_that_the_locale_does_not_have(monkeypatch):
    from jaxisp.io import files

    monkeypatch.setattr(os, "fsencode", lambda path: "é.png".encode())  # as in the C locale
    with pytest.raises(InputError, match=r"this locale has; set LC_ALL=C\.UTF-8"):
        files.sound_path("\udcc3\udca9.png")


def test_the_self_check_compiles_whatever_is_set():
    from jaxisp.process.selfcheck import measured_error

    with jax.disable_jit():
        assert measured_error() < 1e-5


def test_a_user_without_a_home(monkeypatch, capsys):
    """As in a container, whose user has no entry in the list of users."""
    for name in ("HOME", "XDG_CACHE_HOME", "JAXISP_CACHE", "JAXISP_DATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda number: {}[number])
    assert cache.cache_folder() is None
    assert main(["data", "list"]) == 2
    assert capsys.readouterr().err == (
        "jaxisp: there is no home folder to keep data sets in: set JAXISP_DATA to a folder\n"
    )
    monkeypatch.setenv("JAXISP_DATA", "~nobody here/sets")
    assert main(["data", "fetch", "kodak"]) == 2
    assert "JAXISP_DATA=~nobody here/sets: there is no such home" in capsys.readouterr().err


@pytest.mark.parametrize(("own", "used"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_a_command_multiplies_on_one_thread_unless_told_otherwise(own, used):
    code = (
        "import atexit, os, sys; sys.argv = ['jaxisp', '--version']\n"
        "atexit.register(lambda: print(os.environ['OPENBLAS_NUM_THREADS']))\n"
        "from jaxisp.__main__ import main; assert 'numpy' not in sys.modules; main()"
    )
    rest = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=rest | own)
    assert done.stdout.split()[-1] == used, done.stderr


def test_xlas_log_is_set_before_jax_reads_it():
    """A program that a command kept is loaded without lines that speak of errors and are none."""
    watch = (
        "import os, sys\n"
        "class Watch:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'jax': print(os.environ.get('TF_CPP_MIN_LOG_LEVEL'), file=sys.stderr)\n"
        "sys.meta_path.insert(0, Watch())\n"
        "sys.argv = ['jaxisp', 'recipes']\n"
        "from jaxisp.cli import main\n"
        "main()\n"
    )
    own = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}
    for given, told in ({}, "3"), ({"TF_CPP_MIN_LOG_LEVEL": "1"}, "1"):
        done = subprocess.run(
            [sys.executable, "-c", watch], capture_output=True, text=True, env={**own, **given}, timeout=60
        )
        assert done.stderr == f"{told}\n"
