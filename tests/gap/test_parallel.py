"""Looking at points side by side."""

import threading

import pytest

from jaxisp.gap import parallel


@pytest.mark.parametrize("count", [0, 1, 2, 9])
@pytest.mark.parametrize("most", [1, 4])
def test_what_is_found_is_in_order(count, most, monkeypatch):
    monkeypatch.setattr(parallel, "MOST", most)
    assert parallel.parallel_map(lambda n: n * n, iter(range(count))) == [n * n for n in range(count)]


def test_an_error_comes_through(monkeypatch):
    monkeypatch.setattr(parallel, "MOST", 4)
    with pytest.raises(ZeroDivisionError):
        parallel.parallel_map(lambda n: 1 / n, [3, 2, 1, 0])


def test_points_are_looked_at_at_once(monkeypatch):
    monkeypatch.setattr(parallel.cores, "available", lambda: 2)
    monkeypatch.setattr(parallel, "MOST", 2)
    met = threading.Barrier(2, timeout=30)
    parallel.parallel_map(lambda n: n == 0 or met.wait(), range(3))


def test_work_is_done_meanwhile_and_waited_for():
    met, done = threading.Barrier(2, timeout=30), []
    with parallel.in_background(lambda: (met.wait(), done.append(1))):
        met.wait()
    assert done == [1]


def test_an_error_of_either_side_comes_through():
    with pytest.raises(ZeroDivisionError), parallel.in_background(lambda: 1 / 0):
        pass
    with pytest.raises(KeyError), parallel.in_background(lambda: 1 / 0):
        raise KeyError
