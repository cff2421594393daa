# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Train a denoiser
#
# The question of the paper: does it matter on which noise a denoiser is trained? A small network learns
# white Gaussian noise here, and is then given two kinds of noisy photographs: with that noise, and with
# the noise that a mosaic and its demosaicking leave. A few seconds make no good denoiser, but are enough
# to see which way it goes.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from flax import nnx

from jaxisp import recipes
from jaxisp.data import CleanPatches, load_clean
from jaxisp.explore import Pictures
from jaxisp.io import write_png
from jaxisp.metrics import psnr
from jaxisp.models import count_parameters, make_model
from jaxisp.samples import scene
from jaxisp.stages.transfer import srgb_oetf
from jaxisp.train import Denoiser, TrainConfig, init_state, make_optimizer, make_step, weights

STEPS, BATCH, PATCH = 400, 8, 32

folder = Path(tempfile.mkdtemp())
for name in ("astronaut", "coffee", "rocket"):
    write_png(folder / f"{name}.png", np.asarray(srgb_oetf(scene(name, 240))))
images = load_clean(folder, patch=PATCH, downsample=1)
patches = CleanPatches(images, PATCH, per_image=40, seed=0)
print(f"{len(images.images)} photographs, {len(patches)} patches an epoch")

# %% [markdown]
# ## A step
#
# Degrading is a part of the compiled step: clean patches go to the device and noisy ones never exist
# outside it. Patch *i* is degraded with the key `fold_in(key, i)`, so that a run is the same on one
# device or eight, and after an interruption.

# %%
config = TrainConfig(
    clean=(str(folder),), recipe="-", steps=STEPS, batch=BATCH, patch=PATCH, lr=4e-3, warmup=20
)


def trained(recipe):
    model, optimizer = make_model("fast", seed=0), make_optimizer(config, STEPS)
    step = make_step(model, recipe, optimizer, key=jax.random.key(0), ema=0.98)
    state, losses = init_state(model, optimizer, ema=0.98), []
    for i in range(0, STEPS * BATCH, BATCH):
        clean = np.stack([patches.sample(j) for j in range(i, i + BATCH)])
        state, metrics = step(state, clean, i)
        losses.append(metrics["loss"])
    return Denoiser(nnx.merge(nnx.graphdef(model), *weights(state))), np.asarray(losses)


print(f"{count_parameters(make_model('fast')):,} weights")

# %%
denoiser, losses = trained(recipes.awgn())
figure, axes = plt.subplots(figsize=(4.5, 2))
axes.semilogy(losses)
axes.set(xlabel="step", ylabel="mean absolute error")
figure.tight_layout()

# %% [markdown]
# ## Where it helps
#
# A photograph that it has not seen, degraded both ways.

# %%
corners = [(0, 0.3), (0, 0.7), (1, 0.3), (1, 0.7)]
test = np.stack([np.asarray(srgb_oetf(scene("chelsea", 96, (y, x, 0.4)))) for y, x in corners])


def decibels(pictures):
    return np.mean([psnr(picture, clean) for picture, clean in zip(pictures, test)])


shown = [("clean", test[0])]
for name in ("awgn", "phone-bilinear"):
    noisy, _, _ = recipes.find_recipe(name).degrade(jax.random.key(99), test)
    denoised = [denoiser(picture) for picture in noisy]
    print(f"{name:15} {decibels(noisy):.2f} dB, denoised {decibels(denoised):.2f} dB")
    shown += [(f"{name}", noisy[0]), (f"{name}, denoised", denoised[0])]
Pictures(shown, magnify=2)

# %% [markdown]
# A network that was trained on white noise takes it for granted that the errors of neighbours are
# independent. After demosaicking they are not: blotches pass for the picture. So much of the gain on its
# own noise does not carry over.
#
# Replace `recipes.awgn()` by `recipes.phone()` above to train on a camera's noise. That is harder to
# learn: the 400 steps of this notebook are too few for it to show. For a run that is worth keeping use
# `jaxisp train` or `jaxisp.train.train`: checkpoints, validation, resuming, many devices, logs, a model
# card; `jaxisp evaluate` then measures it on real pairs.
