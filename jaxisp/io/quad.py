"""Patterns of colour filters; those of n x n pixels each (quad Bayer and larger) made a Bayer mosaic."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxisp.cfa import PATTERNS, is_xtrans, shifted
from jaxisp.io.opcodes import GainMap, Opcode

_MOST_CELL = 16  # rows and columns of a repeated cell
_LARGEST = 4
_STRIP = 512  # rows that are made at once: what a frame of 200 megapixels takes is bounded


class Filters(NamedTuple):
    """A pattern whose every filter covers `size` x `size` pixels.

    Args:
        cfa: of the filters, from the first that is whole.
        size: 1 for a plain Bayer mosaic and for X-Trans.
        start: row and column of the first filter that is whole, both below `size`.
    """

    cfa: str
    size: int = 1
    start: tuple[int, int] = (0, 0)

    @property
    def cell(self) -> str:
        """The pattern of the pixels, which repeats after 2 `size` of them, from the top-left."""
        bayer = np.array(list(self.cfa)).reshape(2, 2)
        large = np.kron(np.arange(4).reshape(2, 2), np.ones((self.size, self.size), int))
        return "".join(np.roll(bayer.ravel()[large], self.start, (0, 1)).ravel())

    def after(self, rows: int, columns: int) -> "Filters":
        """Those seen after cropping that many rows and columns off the top and left."""
        starts = [(own - cut) % self.size for own, cut in zip(self.start, (rows, columns))]
        passed = [
            (cut + new - own) // self.size for own, cut, new in zip(self.start, (rows, columns), starts)
        ]
        return Filters(shifted(self.cfa, *passed), self.size, (starts[0], starts[1]))


def filters(cell: np.ndarray) -> Filters | None:
    """What a repeated cell (rows, columns) of 0, 1, 2 for R, G, B is; None where it is no known pattern."""
    if max(cell.shape) > _MOST_CELL:
        return None
    names = np.array(list("RGB"))[cell]
    if cell.shape == (6, 6) and is_xtrans(cfa := "".join(names.ravel())):
        return Filters(cfa)
    for size in range(1, _LARGEST + 1):
        shape = [math.lcm(n, 2 * size) for n in cell.shape]
        whole = np.tile(cell, [n // own for n, own in zip(shape, cell.shape)])
        for top, left in np.ndindex(size, size):
            turned = np.roll(whole, (-top, -left), (0, 1))
            bayer = turned[: 2 * size : size, : 2 * size : size]
            large = np.kron(bayer, np.ones((size, size), int))
            cfa = "".join("RGB"[i] for i in bayer.ravel())
            if cfa in PATTERNS and (np.tile(large, [n // (2 * size) for n in shape]) == turned).all():
                return Filters(cfa, size, (top, left))
    return None


def binned(mosaic: np.ndarray, own: Filters) -> np.ndarray:
    """(H // size, W // size) means of the pixels of each whole filter."""
    top, left = own.start
    rows, columns = ((n - cut) // own.size for n, cut in zip(mosaic.shape, own.start))
    whole = mosaic[top : top + rows * own.size, left : left + columns * own.size]
    return whole.reshape(rows, own.size, columns, own.size).mean((1, 3), dtype=np.float32)


def remosaicked(mosaic: np.ndarray, own: Filters, gains: np.ndarray) -> tuple[np.ndarray, str]:
    """The Bayer mosaic of full size, and its pattern.

    A pixel that has the colour wanted stays as it is. Another has the local mean of the colour wanted, and
    the detail that it saw itself, as grey has it: exact where the picture is flat or grey and a ramp. Beyond
    its borders the picture goes on straight.

    Args:
        mosaic: (H, W), linear.
        own: its filters.
        gains: (3,) of R, G, B that balance it.
    """
    cfa, period = shifted(own.cfa, *own.start), 2 * own.size
    out = np.empty_like(mosaic)
    wide = _extended(_extended(mosaic, period, 0), period, 1)  # by a period: no phase changes
    down, across = ((n - before) // 2 for n, before in zip(wide.shape, mosaic.shape))
    for top in range(0, mosaic.shape[0], _STRIP):
        first = max(0, top + down - period)
        part = wide[first : top + down + _STRIP + period]
        made = _remosaicked(part, own.after(first, 0), shifted(cfa, first, 0), gains)
        inner = made[top + down - first :][:_STRIP, across : across + mosaic.shape[1]]
        out[top : top + _STRIP] = inner[: mosaic.shape[0] - top]
    return out, cfa


def _extended(mosaic: np.ndarray, period: int, axis: int) -> np.ndarray:
    """The mosaic, a period longer at both ends of an axis, where each pixel goes on as it rose over the last
    period; as it is where it is shorter than two."""
    if mosaic.shape[axis] < 2 * period:
        return mosaic
    first, second = np.split(mosaic.take(range(2 * period), axis), 2, axis)
    before, last = np.split(mosaic.take(range(-2 * period, 0), axis), 2, axis)
    return np.concatenate([2 * first - second, mosaic, 2 * last - before], axis)


def _remosaicked(mosaic: np.ndarray, own: Filters, cfa: str, gains: np.ndarray) -> np.ndarray:
    rows, columns = np.ogrid[: mosaic.shape[0], : mosaic.shape[1]]
    has = _colors(own.cfa)[(rows - own.start[0]) // own.size % 2, (columns - own.start[1]) // own.size % 2]
    wanted = _colors(cfa)[rows % 2, columns % 2]
    means = np.stack([_local_mean(mosaic, has == color, 2 * own.size) for color in range(3)])
    rate = (gains[:, None] / gains).astype(np.float32)  # of the detail of one colour in another
    detail = mosaic - np.take_along_axis(means, has[None], 0)[0]
    other = np.take_along_axis(means, wanted[None], 0)[0] + detail * rate[has, wanted]
    return np.where(has == wanted, mosaic, other)


def _colors(cfa: str) -> np.ndarray:
    return np.array(["RGB".index(color) for color in cfa]).reshape(2, 2)


def _local_mean(mosaic: np.ndarray, where: np.ndarray, period: int) -> np.ndarray:
    """The mean of the linear interpolations between pixels that lie a period apart."""
    from scipy.ndimage import convolve1d  # slow to import, and seldom needed

    tent = (1 - np.abs(np.arange(1 - period, period)) / period).astype(np.float32)

    def smooth(plane: np.ndarray) -> np.ndarray:
        for axis in (0, 1):
            plane = convolve1d(plane, tent, axis, mode="constant")
        return plane

    return smooth(np.where(where, mosaic, np.float32(0))) / smooth(where.astype(np.float32))


def reduced(opcode: Opcode, own: Filters) -> Opcode:
    """The opcode for the binned active area, whose filters are `own`; maps must be for every pixel."""
    if not isinstance(opcode, GainMap):
        return opcode
    top, left, bottom, right = (
        max(0, -(-(place - own.start[i % 2]) // own.size)) for i, place in enumerate(opcode.rectangle)
    )
    return replace(opcode, rectangle=(top, left, bottom, right))
