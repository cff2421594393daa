"""A fit over many devices has the normal equations of one; two processes have the bits of one."""

import copy
import hashlib
import json
import os
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest
from jax.sharding import Mesh

from jaxisp.errors import InputError
from jaxisp.fit import Example, fit_dataset, model
from jaxisp.fit.journal import Journal
from jaxisp.fit.search import Options, Search
from jaxisp.fit.sharing import CAMERA, Layout, sharing
from jaxisp.fit.spread import agree
from jaxisp.fit.tiles import SOURCE, TILES, no_chunk, prepare, with_source
from jaxisp.io import open_dataset
from jaxisp.recipe import Recipe
from jaxisp.samples import PHONES, scenes, write_pairs

WHAT = {"steps": 2, "demosaic": "demosaic_bilinear", "median": "none"}
FLAGS = ["--steps", "2", "--demosaic", "demosaic_bilinear", "--median", "none"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("pairs")
    write_pairs(path, PHONES["a"], list(scenes((160, 224)))[:1])
    return path


def mesh_of(count):
    return Mesh(np.asarray(jax.devices()[:count]), ("tiles",))


@pytest.fixture(scope="module")
def spread(folder):
    return fit_dataset(folder, **WHAT, mesh=mesh_of(2))


@pytest.mark.slow
def test_eight_devices_give_the_equations_of_one(folder):
    pair = open_dataset(folder).pairs[0].load()
    shot = prepare(Example("scene", pair.raw, pair.picture, pair.jpeg))
    options = Options(2, WHAT["demosaic"], WHAT["median"], "camera", ())
    search = Search([shot], options, Journal.open(None, ""), lambda *_: None)
    one, many = (copy.copy(search._fit(options.first)) for _ in range(2))
    many.mesh = mesh_of(8)
    assert many.mesh.size == 8 and len(one._chunks) == 2  # six devices get what does not count
    # the encoder rounds: there a step of 1e-6 moves the objective by 2e-4 already
    coded = [fit.equations(search.origin).objective for fit in (many, one)]
    assert coded[0] == pytest.approx(coded[1], rel=2e-4)
    many, one = (fit.without_encoder() for fit in (many, one))
    at, wanted = (fit.equations(search.origin) for fit in (many, one))
    assert at.objective == pytest.approx(wanted.objective, rel=1e-6)
    # rounding of 1e-6 of a picture, over the steps of the differences
    np.testing.assert_allclose(at.matrix, wanted.matrix, atol=1e-5 * np.abs(wanted.matrix).max())
    np.testing.assert_allclose(at.vector, wanted.vector, atol=1e-4 * np.abs(wanted.vector).max())
    moved = search.origin.moved(np.full(len(at.vector), 1e-3))
    places = [fit.place(moved, near) for fit, near in ((many, at), (one, wanted))]
    assert places[0].objective == pytest.approx(places[1].objective, rel=1e-5)
    assert np.abs(places[0].vector - places[1].vector).max() < 1e-3 * np.abs(places[1].vector).max()


@pytest.mark.slow
def test_two_processes_give_the_bits_of_one(folder, spread, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    out = tmp_path / "camera.toml"
    command = [sys.executable, "-m", "jaxisp", "fit", folder, "-o", out, "--json", *FLAGS]
    joined = ["--coordinator", f"localhost:{port}", "--cpu-devices", "1", "--processes", "2", "--process-id"]
    processes = [
        subprocess.Popen(
            [*command, *joined, str(i)], env={**os.environ, "XLA_FLAGS": ""},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for i in range(2)
    ]  # fmt: skip
    said = [p.communicate(timeout=240) for p in processes]
    assert [p.returncode for p in processes] == [0, 0], said
    assert not said[1][0]  # the first says and writes it
    assert json.loads(said[0][0])["camera"] == str(out)
    assert_same_parameters(Recipe.load(out), spread.camera)
    assert sorted(p.name for p in tmp_path.iterdir() if p.name[0] != ".") == ["camera.toml"]


def digest():
    """Of what the programs of a fit that compile without optimisation give."""
    tiles = np.random.default_rng(0).uniform(size=(TILES, SOURCE, SOURCE)).astype(np.float32)
    designs = [*map(model.Design, model.DEMOSAICKERS), model.Design(passes=1), model.Design(passes=2)]
    chunk = no_chunk()._replace(source=tiles)
    parts = [with_source(chunk, "RGGB", design, once=True).source for design in designs]
    start = model.start()
    parts.append(Layout.of(start, sharing(start)).vector(start, CAMERA))
    return hashlib.sha256(b"".join(np.asarray(p).tobytes() for p in parts)).hexdigest()


@pytest.mark.slow
def test_what_compiles_quickly_has_the_same_bits_on_any_number_of_devices():
    """Unoptimised, a sum of many terms has not: a choice that hangs by it would differ between processes."""
    command = [sys.executable, "-c", "from tests.fit.test_spread import digest; print(digest())"]
    alone = subprocess.check_output(command, env={**os.environ, "XLA_FLAGS": ""}, text=True)
    assert len(jax.devices()) == 8
    assert alone.strip() == digest()


def assert_same_parameters(one, other):
    for a, b in zip(*(jax.tree.leaves(camera.prior) for camera in (one, other)), strict=True):
        np.testing.assert_array_equal(a, b)


def test_processes_that_see_different_pairs_are_refused(monkeypatch):
    monkeypatch.setattr("jaxisp.fit.spread.process_allgather", lambda own: np.stack([own, own[::-1]]))
    monkeypatch.setattr("jax.process_count", lambda: 2)
    with pytest.raises(InputError, match="different pairs"):
        agree("1f")
