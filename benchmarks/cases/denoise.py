"""Denoising: bilateral, median, wavelet, and the bilateral grid for wide chroma."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.case import Case, Peer
from benchmarks.torch_peer import left, tensor
from jaxisp.samples import scene
from jaxisp.stages.denoise.bilateral import bilateral_plane
from jaxisp.stages.denoise.dwt import analyse, synthesise
from jaxisp.stages.denoise.grid import grid_planes
from jaxisp.stages.denoise.median import median_plane

# the peer's time over ours
BILATERAL_GOALS, MEDIAN_GOALS = {2: 1 / 0.7, 3: 1 / 0.6, 5: 1 / 0.85}, {3: 0.4, 5: 0.8}  # OpenCV
KORNIA_BILATERAL_GOALS, WAVELET_GOALS = {"batch": 2.5, "1 MP": 4.0}, {"batch": 18.0, "1 MP": 4.0}
SIGMA_RANGE, LEVELS = 0.1, 3
AUTHORS_MS = {"batch": 2293, "1 MP": 9025}


def cases() -> Iterator[Case]:
    for size, planes in data().items():
        on_device = jax.device_put(planes)
        for radius in BILATERAL_GOALS:
            yield bilateral_case(size, planes, on_device, radius)
        for side in MEDIAN_GOALS:
            yield median_case(size, planes, on_device, side)
        yield wavelet_case(size, planes, on_device)
        yield grid_case(size, on_device)


def data() -> dict[str, np.ndarray]:
    """Noisy planes: three for each of 32 images, and three of one large image."""
    picture = np.clip(scene("astronaut", (400, 500)), 0, 1)
    rng = np.random.default_rng(0)
    large = np.moveaxis(np.tile(picture, (3, 2, 1))[:1000, :1000], -1, 0)
    small = [picture[y : y + 80, x : x + 80] for y in range(0, 320, 80) for x in range(0, 400, 50)]
    batch = np.moveaxis(np.stack(small), -1, 1).reshape(-1, 80, 80)
    sets = {"batch": batch, "1 MP": large}
    return {k: (v + rng.normal(0, 0.03, v.shape)).astype(np.float32) for k, v in sets.items()}


def each(fn: Callable[[np.ndarray], Any], planes: np.ndarray) -> Callable[[], np.ndarray]:
    return lambda: np.stack([fn(p) for p in planes])


def optional(name: str) -> Any:
    try:
        return __import__(name)
    except ImportError:
        return None


def difference(border: int = 0) -> Callable[[Any, Any], str]:
    """The largest difference, `border` pixels from the edges."""
    inside = (..., slice(border, -border or None), slice(border, -border or None))

    def agrees(ours: Any, theirs: Any) -> str:
        apart = np.abs(np.asarray(ours)[inside] - np.asarray(theirs)[inside]).max()
        return f"max difference {apart:.1e}" + (f", {border} px inside" if border else "")

    return agrees


def forward_and_gradient(
    fn: Callable[..., jax.Array], *arguments: Any
) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """A vmapped call over the planes, and its gradient to every argument."""
    axes = tuple(0 if np.ndim(a) else None for a in arguments)
    forward = jax.jit(jax.vmap(fn, in_axes=axes))
    argnums = tuple(range(len(arguments)))
    gradient = jax.jit(jax.grad(lambda *a: jnp.sum(jax.vmap(fn, in_axes=axes)(*a) ** 2), argnums))
    return lambda: forward(*arguments), lambda: gradient(*arguments)


def bilateral_case(size: str, planes: np.ndarray, on_device: jax.Array, radius: int) -> Case:
    d, space = 2 * radius + 1, radius / 2
    taps = sum(
        y * y + x * x <= radius**2 for y in range(-radius, radius + 1) for x in range(-radius, radius + 1)
    )
    ours, gradient = forward_and_gradient(
        lambda p, s, r: bilateral_plane(p, p, s, r, radius),
        on_device,
        np.float32(space),
        np.float32(SIGMA_RANGE),
    )
    peers = []
    if cv2 := optional("cv2"):
        call = each(
            lambda p: cv2.bilateralFilter(p, d, SIGMA_RANGE, space, borderType=cv2.BORDER_REFLECT_101), planes
        )
        for threads in (1, None):
            name = f"OpenCV float32, {'one thread' if threads else 'all threads'}"
            goal = BILATERAL_GOALS[radius] if threads else None
            peers.append(Peer(name, call, goal, difference(), threads))
    if kornia := _kornia():
        images = tensor(planes[:, None])
        run = lambda: left(kornia.filters.bilateral_blur(images, d, SIGMA_RANGE, (space, space)))  # noqa: E731
        peers.append(Peer("kornia (square window)", run, KORNIA_BILATERAL_GOALS[size]))
    if size == "batch" and radius == 2 and optional("skimage"):
        from skimage.restoration import denoise_bilateral

        run = each(lambda p: denoise_bilateral(p, d, SIGMA_RANGE, space), planes)
        peers.append(Peer("scikit-image (square window)", run))
    work = {"bytes_moved": 8 * planes.size, "flops": 18 * taps * planes.size}
    return Case(f"bilateral d{d}, 3 planes each", size, ours, tuple(peers), gradient, **work)


def median_case(size: str, planes: np.ndarray, on_device: jax.Array, side: int) -> Case:
    from scipy import ndimage

    ours, gradient = forward_and_gradient(lambda p: median_plane(p, f"{side}x{side}"), on_device)
    peers = []
    if cv2 := optional("cv2"):
        call = each(lambda p: cv2.medianBlur(p, side), planes)
        peers.append(Peer("OpenCV float32", call, MEDIAN_GOALS[side], difference(side // 2)))
    call = each(lambda p: ndimage.median_filter(p, size=side, mode="mirror"), planes)
    peers.append(Peer("SciPy", call, 50.0, difference()))
    if kornia := _kornia():
        images = tensor(planes[:, None])
        run = lambda: left(kornia.filters.median_blur(images, side)[:, 0])  # noqa: E731
        peers.append(Peer("kornia", run, 12.0, difference(side // 2)))
    work = {"bytes_moved": 8 * planes.size, "flops": {3: 18, 5: 106}[side] * planes.size}
    return Case(f"median {side}x{side}, 3 planes each", size, ours, tuple(peers), gradient, **work)


def wavelet_case(size: str, planes: np.ndarray, on_device: jax.Array) -> Case:
    def there_and_back(plane: jax.Array) -> jax.Array:
        low, pyramid = plane, []
        for _ in range(LEVELS):
            shape = low.shape
            low, *details = analyse(low, "db2")
            pyramid.append((shape, details))
        for shape, (h, v, d) in reversed(pyramid):
            low = synthesise((low, h, v, d), shape, "db2")
        return low

    ours, gradient = forward_and_gradient(there_and_back, on_device)
    peers = []
    if pywt := optional("pywt"):

        def theirs(plane: np.ndarray) -> np.ndarray:
            bands = pywt.wavedec2(plane, "db2", mode="symmetric", level=LEVELS)
            return pywt.waverec2(bands, "db2", mode="symmetric")

        peers.append(Peer("PyWavelets", each(theirs, planes), WAVELET_GOALS[size], difference()))
    work = {"bytes_moved": 8 * planes.size, "flops": 43 * planes.size}
    title = f"wavelet db2, {LEVELS} levels there and back, 3 planes each"
    return Case(title, size, ours, tuple(peers), gradient, **work)


def grid_case(size: str, on_device: jax.Array) -> Case:
    """Two chroma planes by a luma, a width for each image from 6 to 40 px."""
    images = on_device.reshape(-1, 3, *on_device.shape[1:])
    widths = jnp.geomspace(6, 40, len(images)) if len(images) > 1 else jnp.full(1, 15.0)
    filtered = lambda x, s: jnp.stack(grid_planes((x[0], x[2]), x[1], s, 0.02))  # noqa: E731
    ours, gradient = forward_and_gradient(filtered, images, widths)
    notes = f"the paper's own grid takes {AUTHORS_MS[size]} ms of one CPU (a stated figure)"
    moved = 20 * on_device.size / 3
    return Case(
        "bilateral grid, chroma by luma", size, ours, (), gradient, moved, 1000 * on_device.size / 3, notes
    )


def _kornia() -> Any:
    return optional("kornia") if optional("torch") else None
