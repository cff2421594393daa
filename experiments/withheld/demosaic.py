"""Demosaickers: three of OpenCV's and two written here from their papers.

Each takes a mosaic in which one is white and the name of its CFA, and returns (H, W, 3) red, green, blue.
"""

from collections.abc import Callable

import cv2
import numpy as np
from scipy import ndimage

MARGIN = 8


def masks(shape: tuple[int, ...], cfa: str) -> np.ndarray:
    """(3, H, W): where red, green and blue are measured."""
    found = np.zeros((3, *shape), bool)
    for place, colour in enumerate(cfa):
        found["RGB".index(colour), place // 2 :: 2, place % 2 :: 2] = True
    return found


def mosaicked(rgb: np.ndarray, cfa: str) -> np.ndarray:
    return np.select(list(masks(rgb.shape[:2], cfa)), [rgb[..., c] for c in range(3)])


def opencv(mosaic: np.ndarray, cfa: str, kind: str = "") -> np.ndarray:
    """OpenCV's bilinear or edge-aware ("_EA") interpolation, in 16 bits with room below zero."""
    code = getattr(cv2, f"COLOR_Bayer{cfa}2RGB{kind}")
    packed = np.clip(np.rint((mosaic + 0.25) * 32000), 0, 65535).astype(np.uint16)
    return cv2.demosaicing(packed, code).astype(float) / 32000 - 0.25


def variable_gradients(mosaic: np.ndarray, cfa: str) -> np.ndarray:
    """OpenCV's VNG takes 8 bits only: it gets the square root, and what rounding left is added bilinearly."""
    root = np.sqrt(np.clip(mosaic, 0, 1))
    packed = np.rint(root * 255).astype(np.uint8)
    found = cv2.demosaicing(packed, getattr(cv2, f"COLOR_Bayer{cfa}2RGB_VNG")).astype(float) / 255
    found = found + opencv(root - packed / 255, cfa)
    return found * np.abs(found)


def malvar(mosaic: np.ndarray, cfa: str) -> np.ndarray:
    """Malvar, He and Cutler 2004: linear 5x5 filters."""
    red, green, blue = masks(mosaic.shape, cfa)
    rows_of_red = red.any(axis=1)[:, None] & np.ones_like(red)
    cross = _kernel({(0, 0): 4, (1, 0): 2, (2, 0): -1}, turned=True)
    along = _kernel({(0, 0): 5, (0, 1): 4, (0, 2): -1, (1, 1): -1, (2, 0): 0.5}, turned=False)
    diagonal = _kernel({(0, 0): 6, (1, 1): 2, (2, 0): -1.5, (0, 2): -1.5}, turned=False)
    g = np.where(green, mosaic, _filter(mosaic, cross))
    horizontal, vertical = _filter(mosaic, along), _filter(mosaic, along.T)
    opposite = _filter(mosaic, diagonal)
    on_red_row = green & rows_of_red
    on_blue_row = green & ~rows_of_red
    r = np.select([red, on_red_row, on_blue_row], [mosaic, horizontal, vertical], opposite)
    b = np.select([blue, on_blue_row, on_red_row], [mosaic, horizontal, vertical], opposite)
    return np.stack([r, g, b], axis=-1)


def _kernel(taps: dict[tuple[int, int], float], turned: bool) -> np.ndarray:
    kernel = np.zeros((5, 5))
    for (dy, dx), weight in taps.items():
        for sy in {dy, -dy}:
            for sx in {dx, -dx}:
                kernel[2 + sy, 2 + sx] = weight
    if turned:
        kernel = np.where(kernel != 0, kernel, kernel.T)
    return kernel / 8


def _filter(x: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    return ndimage.correlate(x, kernel, mode="mirror")


def hamilton_adams(mosaic: np.ndarray, cfa: str) -> np.ndarray:
    """Hamilton and Adams 1997: green along the flatter direction, colours by differences to it."""
    red, green, blue = masks(mosaic.shape, cfa)
    mean, second = np.array([[0.5, 0, 0.5]]), np.array([[-1.0, 0, 2, 0, -1]])
    step = np.array([[-1.0, 0, 1]])
    guesses, costs = [], []
    for turn in (lambda k: k, np.transpose):
        curve = _filter(mosaic, turn(second))
        guesses.append(_filter(mosaic, turn(mean)) + curve / 4)
        costs.append(np.abs(_filter(mosaic, turn(step))) + np.abs(curve))
    level = np.isclose(*costs)
    chosen = np.where(level, sum(guesses) / 2, np.where(costs[0] < costs[1], *guesses))
    g = np.where(green, mosaic, chosen)
    spread = np.array([[1.0, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4
    planes = [g + _filter(np.where(mask, mosaic - g, 0.0), spread) for mask in (red, blue)]
    return np.stack([planes[0], g, planes[1]], axis=-1)


DEMOSAICKERS: dict[str, Callable[[np.ndarray, str], np.ndarray]] = {
    "bilinear": opencv,
    "edge-aware": lambda mosaic, cfa: opencv(mosaic, cfa, "_EA"),
    "variable-gradients": variable_gradients,
    "malvar": malvar,
    "hamilton-adams": hamilton_adams,
}


def demosaic(mosaic: np.ndarray, cfa: str, name: str, border: str = "reflect") -> np.ndarray:
    """Demosaic by name; `border` is "reflect", "cells" (the last 2x2 cell repeats) or "own" (none)."""
    if border == "own":
        return DEMOSAICKERS[name](mosaic, cfa)
    if border == "reflect":
        padded = np.pad(mosaic, MARGIN, mode="reflect")
    else:
        height, width = mosaic.shape
        cells = mosaic.reshape(height // 2, 2, width // 2, 2)
        around = (MARGIN // 2, MARGIN // 2)
        cells = np.pad(cells, (around, (0, 0), around, (0, 0)), mode="edge")
        padded = cells.reshape(height + 2 * MARGIN, width + 2 * MARGIN)
    return DEMOSAICKERS[name](padded, cfa)[MARGIN:-MARGIN, MARGIN:-MARGIN]
