"""Where a fit begins: exposure and colour matrix by least squares in linear light."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxisp.fit import model
from jaxisp.fit.lens import STRAIGHT, Lens
from jaxisp.fit.state import View
from jaxisp.fit.tiles import HALO, Chunk
from jaxisp.fit.usual import usual_matrix
from jaxisp.pipeline import Params
from jaxisp.process.programs import QUICK
from jaxisp.stages.balance import ColorMatrix
from jaxisp.stages.optics import Exposure, GeometricDistortion
from jaxisp.stages.transfer import srgb_eotf

SPREAD = 0.3  # standard deviation of a matrix's entries
_BLOCK = 8
_NOTHING = 1e-9


def begin(views: Sequence[View], lens: Lens = STRAIGHT) -> Params:
    """The parameters a fit starts from."""
    pixels = [_block_means(view, chunk, lens) for view in views for chunk in view.chunks]
    source, wanted = (np.concatenate(parts) for parts in zip(*pixels))
    gain = float(np.clip(wanted.sum() / max(source.sum(), _NOTHING), 2.0**-6, 2.0**6))
    matrix = _near_usual(gain * source, wanted)
    return model.start() | {
        "exposure": Exposure(exposure_ev=np.float32(np.log2(gain))),
        "color_matrix": ColorMatrix(matrix=np.clip(matrix, -3.9, 3.9).astype(np.float32)),
        "geometric_distortion": GeometricDistortion(k1=np.float32(lens.k1)),
    }


def _near_usual(source: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Least squares, held near real cameras' matrix by as much as that one leaves: a scene may lack hues."""
    usual = usual_matrix()
    scaled = source @ usual.T
    gains = (scaled * wanted).sum(0) / np.maximum((scaled**2).sum(0), _NOTHING)
    usual *= np.maximum(gains, _NOTHING)[:, None]
    left = wanted - source @ usual.T
    ridge = (left**2).mean() / SPREAD**2
    square = source.T @ source + ridge * np.eye(3)
    return usual + np.linalg.solve(square, source.T @ left).T


def _block_means(view: View, chunk: Chunk, lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) means of whole 8x8 blocks, camera RGB and wanted, in linear light: free of noise and detail.

    The source is read at the nearest whole pixel.
    """
    wanted = np.asarray(_linear(jnp.asarray(chunk.target)))
    size = wanted.shape[1]
    source = []
    for tile, place in zip(np.asarray(chunk.source), np.asarray(chunk.place, float)):
        index = HALO + np.arange(size)
        y, x = (view.geometry[2 + a] * (place[a] + index) + view.geometry[a] for a in range(2))
        bent = lens.bent(y[:, None], x[None], float(chunk.corner))
        rows, columns = (np.rint(p - first).astype(int) for p, first in zip(bent, place[2:]))
        last = len(tile) - 1
        source.append(tile[np.clip(rows, 0, last), np.clip(columns, 0, last)])
    whole = _means(np.asarray(chunk.mask)[..., None])[:, 0] == 1
    return _means(np.stack(source))[whole], _means(wanted)[whole]


_linear = jax.jit(srgb_eotf, compiler_options=QUICK)  # operation by operation takes longer to compile


def _means(tiles: np.ndarray) -> np.ndarray:
    count, size, _, channels = tiles.shape
    n = size // _BLOCK
    blocks = tiles.reshape(count, n, _BLOCK, n, _BLOCK, channels)
    return blocks.mean((2, 4)).reshape(-1, channels)
