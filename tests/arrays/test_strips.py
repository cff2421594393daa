"""Strips of a large frame: the picture and the gradients of the whole, in less memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxisp.arrays import strips
from jaxisp.arrays.barriers import materialize
from jaxisp.arrays.stencils import pad, views
from jaxisp.arrays.strips import in_strips, in_strips_on_cpu
from jaxisp.pipeline import run, stage
from jaxisp.stages.blur import OpticalBlur
from jaxisp.stages.denoise.bilateral import bilateral_plane
from jaxisp.stages.denoise.median import median_plane
from jaxisp.stages.detail import UnsharpMask

UNSHARP = {"unsharp_mask": UnsharpMask(amount=0.8, sigma=0.9, threshold=0.02)}
BLUR = {"optical_blur": OpticalBlur(sigma=0.9)}


@pytest.mark.parametrize("height", [20, 21, 64, 97])
def test_strips_are_the_whole(height, rng):
    """With the parity of each row, which a mosaic tells by; several results, and one with colours."""
    image = rng.random((height, 7, 3)).astype(np.float32)

    def fn(x):
        above, below = views(pad(x[..., 0], (2, 0)), [(-2, 0), (2, 0)], (2, 0))
        odd = jnp.arange(len(x))[:, None] % 2
        return above - below + odd, 2 * x

    for got, want in zip(in_strips(fn, image, 2, rows=10), fn(image)):
        np.testing.assert_allclose(got, want, atol=1e-6)


@pytest.fixture
def small(monkeypatch):
    """Frames that count as large, so that strips are taken of 300 rows."""
    monkeypatch.setattr(strips, "_LARGE", 2000)
    monkeypatch.setattr(strips, "_STRIP", 0)


def test_a_large_frame_has_the_gradient_of_the_whole(rng, small):
    image, weights = rng.random((2, 300, 9)).astype(np.float32)

    def fn(x, scale, _):
        return scale * views(pad(x, 1), [(1, 0)], 1)[0] ** 2

    def loss(call):
        return jax.jit(jax.value_and_grad(lambda x, s: jnp.sum(weights * call(x, s)), argnums=(0, 1)))

    got = loss(lambda x, s: in_strips_on_cpu(fn, x, 1, (s, jnp.arange(3))))(image, 1.5)
    want = loss(lambda x, s: fn(x, s, None))(image, 1.5)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), got, want)
    call = lambda x: in_strips_on_cpu(fn, x, 1, (1.5, None))  # noqa: E731
    assert "while" in jax.jit(call).lower(image).as_text()
    np.testing.assert_allclose(jax.vmap(call)(image[None])[0], fn(image, 1.5, None), rtol=1e-6)


@pytest.mark.parametrize("height", [300, 317])
def test_gradients_in_strips_go_to_every_frame(height, rng, small):
    """Also where the last strip begins within the one before, and one frame of several stands still."""
    frames = {"a": rng.random((height, 9)), "b": rng.random((height, 9, 3))}
    frames = {name: frame.astype(np.float32) for name, frame in frames.items()}
    still = np.arange(height * 9, dtype=np.int32).reshape(height, 9) % 5
    weights = rng.random((height, 9)).astype(np.float32)

    def fn(image, scale):
        up, here = views(pad(image["a"], 2), [(-2, 1), (0, 0)], 2)
        return jnp.sin(scale * up) * here + image["b"].sum(-1) ** 2 * image["still"], image["b"] * scale

    def loss(call):
        def total(frames, scale):
            first, second = call(frames | {"still": still}, scale)
            return jnp.sum(weights * first) + jnp.sum(second**2)

        return jax.jit(jax.grad(total, argnums=(0, 1)))(frames, jnp.float32(0.7))

    strips = lambda image, scale: in_strips_on_cpu(fn, image, 2, (scale,))  # noqa: E731
    alone = lambda image, scale: in_strips_on_cpu(fn, image, 2, (scale,), forward=False)  # noqa: E731
    for got in (loss(strips), loss(alone)):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4), got, loss(fn))
    change = jax.tree.map(jnp.ones_like, frames)

    def moved(call):
        return jax.jit(lambda at: jax.jvp(lambda f: call(f | {"still": still}, 0.7), (at,), (change,))[1])(
            frames
        )

    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5), moved(strips), moved(fn)
    )


@pytest.mark.parametrize(
    "width, smooth",
    [
        (60, lambda x: median_plane(x, "3x3")),
        (60, lambda x: median_plane(x, "5x5")),
        (7, lambda x: bilateral_plane(x, x, 1.2, 0.2, 2)),
        (7, lambda x: run(stage("unsharp_mask", radius=2), UNSHARP, x[..., None].repeat(3, -1))),
        (7, lambda x: run(stage("optical_blur", radius=2), BLUR, x[..., None].repeat(3, -1))),
    ],
)
def test_large_frames_of_the_stages_that_use_strips(width, smooth, rng, monkeypatch):
    image = jnp.asarray(rng.random((305, width)), jnp.float32)

    def both(image):
        y, pull = jax.vjp(smooth, image)
        return y, pull(jnp.cos(7 * y))[0]

    want = jax.jit(both)(image)
    monkeypatch.setattr(strips, "_LARGE", 2000)
    monkeypatch.setattr(strips, "_STRIP", 0)
    jax.clear_caches()
    got = jax.jit(both)(image)
    for a, b in zip(got, want):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("width, strips", [(7, False), (60, True)])
def test_medians_go_in_strips_on_larger_frames_than_others(width, strips, small):
    smooth = jax.jit(lambda x: median_plane(x, "3x3"))
    assert ("while" in smooth.lower(jnp.ones((305, width))).as_text()) == strips


def test_the_gradient_takes_the_memory_of_a_strip(small):
    x = jnp.ones((960, 40))

    def waves(x):
        for _ in range(6):
            x = materialize(views(pad(jnp.sin(x), 1), [(1, 0)], 1)[0] * x)
        return x

    def scratch(fn):
        compiled = jax.jit(jax.grad(lambda v: jnp.sum(fn(v) ** 2))).lower(x).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    assert scratch(lambda v: in_strips_on_cpu(waves, v, 6)) < scratch(waves) / 2
