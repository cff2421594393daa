# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Quickstart
#
# A camera does a great deal to a photograph before you see it: it samples one colour a pixel, adds noise,
# fills the missing colours in, smooths, sharpens, compresses. A denoiser that was trained on white noise
# has never seen the result. `jaxisp` makes it, on the device, for whole batches.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxisp
from jaxisp.explore import Pictures
from jaxisp.samples import scene, scene_names
from jaxisp.stages.transfer import srgb_oetf

scenes = np.stack([scene(name, 80, (0.5, 0.4, 0.5)) for name in scene_names()])  # linear light
clean = np.asarray(srgb_oetf(scenes), np.float32)  # encoded sRGB in [0, 1], as files hold it
Pictures(zip(scene_names(), clean), magnify=2)

# %% [markdown]
# ## Degrade a batch
#
# A recipe is a pipeline with a prior: what each of its parameters is drawn from. `degrade` draws new
# parameters for every image and returns the pictures with them.
#
# The first call compiles: some 10 s for this recipe on two cores. `keep_compiled` keeps the program on disk,
# where the next process finds it. Later calls of the same shape compile nothing, whatever the numbers.

# %%
jaxisp.keep_compiled()
recipe = jaxisp.recipes.phone()
noisy, _, params = recipe.degrade(jax.random.key(0), clean)

read, shot = params["shot_read_noise"].read, params["shot_read_noise"].shot
level = params["jpeg_photoshop"].level
Pictures(
    [(f"read noise {r:.3f}, shot {s:.4f}, JPEG {q:.0f}", n) for r, s, q, n in zip(read, shot, level, noisy)],
    magnify=2,
)

# %% [markdown]
# The noise is coarse and coloured, unlike the white noise of `awgn`: demosaicking has spread every error
# over its neighbours. The correlation between a pixel's noise and its right neighbour's says so in a
# number.

# %%
grey = np.full((4, 80, 80, 3), 0.5, np.float32)
keys = jax.random.key(1)


def neighbours_agree(recipe):
    residual = np.asarray(recipe.degrade(keys, grey)[0]).mean(-1)
    residual = residual - residual.mean((1, 2), keepdims=True)
    return (residual[:, :, 1:] * residual[:, :, :-1]).mean() / (residual**2).mean()


for name in ("awgn", "phone-bilinear", "phone"):
    print(f"{name:15} {neighbours_agree(jaxisp.recipes.find_recipe(name)):+.2f}")

# %% [markdown]
# Image *i* depends on the key and on its own index alone, so any part of a data set can be made again:
# here image 2 by itself.

# %%
third, _, _ = recipe.degrade(jax.random.key(0), clean[2:3], start=2)
print("the same bits:", bool((third[0] == noisy[2]).all()))

# %% [markdown]
# ## Build a pipeline
#
# Stages are pure functions on one image; a `Chain` of them checks that each gets what it needs, and is
# itself one.

# %%
camera = jaxisp.Chain(
    (
        jaxisp.stage("mosaic", cfa="RGGB"),
        jaxisp.stage("shot_read_noise"),
        jaxisp.stage("demosaic_malvar", cfa="RGGB"),
        jaxisp.stage("srgb_oetf"),
        jaxisp.stage("unsharp_mask"),
    )
)
values = camera.init()
values

# %% [markdown]
# ## Gradients
#
# Everything is differentiable: by the parameters as by the image. So a parameter can be read off a
# picture. Somebody sharpened this one; by how much?

# %%
sharpen = jaxisp.stage("unsharp_mask")
secret = {"unsharp_mask": type(values["unsharp_mask"])(amount=1.7, sigma=1.1, threshold=0.0)}
target = jaxisp.run(sharpen, secret, clean[0])


@jax.jit
def step(values):
    loss, slope = jax.value_and_grad(lambda v: jnp.mean((sharpen(v, clean[0]) - target) ** 2))(values)
    return loss, jax.tree.map(lambda v, g: v - 60 * g, values, slope)


values, losses = sharpen.init(), []
for _ in range(150):
    loss, values = step(values)
    losses.append(float(loss))
found = values["unsharp_mask"]
print(f"amount {found.amount:.3f} (1.7), sigma {found.sigma:.3f} (1.1)")

figure, axes = plt.subplots(figsize=(4.5, 2))
axes.semilogy(losses)
axes.set(xlabel="step", ylabel="mean square error")
figure.tight_layout()

# %% [markdown]
# Next: [every stage on one photograph](02_stages.py), or straight to [fitting a
# camera](04_fit_a_camera.py).
