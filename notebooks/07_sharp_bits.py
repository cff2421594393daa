# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Sharp bits
#
# What surprises people, each shown in a few lines. The list in words is in `docs/sharp-bits.md`.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from jaxisp import Chain, Gate, InputError, Shuffle, run, run_batch, stage
from jaxisp.checks import check_params
from jaxisp.params import strong
from jaxisp.samples import scene
from jaxisp.stages.detail import UnsharpMask
from jaxisp.stages.transfer import srgb_oetf

photograph = np.asarray(srgb_oetf(scene("chelsea", (64, 96))), np.float32)
key = jax.random.key(0)

# %% [markdown]
# ## Retracing
#
# New values never recompile; static options and shapes do, and so does a Python number in place of an
# array, once: JAX holds it as another type. `strong` and `check_params` turn numbers into arrays.

# %%
sharpen, traces = stage("unsharp_mask"), []


@jax.jit
def counted(params, image):
    traces.append(1)
    return sharpen(params, image)


def traced(what, params, image=photograph):
    before = len(traces)
    counted(params, image)
    print(f"{what:32} {'traced' if len(traces) > before else 'cached'}")


traced("the defaults", sharpen.init())
traced(
    "other values, as arrays",
    {"unsharp_mask": UnsharpMask(amount=np.float32(2), sigma=np.float32(1), threshold=np.float32(0))},
)
number = {"unsharp_mask": UnsharpMask(amount=2.0, sigma=1.0, threshold=0.0)}
traced("Python numbers", number)
traced("the same through `strong`", strong(number))
traced("another size", sharpen.init(), photograph[:50])

# %% [markdown]
# Switches and orders are values too: a `Gate` or a `Shuffle` runs any subset in any order with one
# compile.

# %%
looks = Shuffle(
    (Gate(stage("saturation")), Gate(stage("unsharp_mask")), Gate(stage("median", footprint="cross")))
)
params = looks.init()
print({name: type(value).__name__ for name, value in params.items()})

# %% [markdown]
# ## Values are checked on the host
#
# Constructors check nothing, because JAX calls them with tracers. Check what comes from outside.

# %%
try:
    check_params({"unsharp_mask": UnsharpMask(amount=9.0)})
except InputError as error:
    print(error)

# %% [markdown]
# ## Keys go by name, samples by index
#
# A stage's noise depends on the key and on the stage's *name*. Leaving another stage out does not change
# it; renaming it does. An image's noise depends on its index in the whole set, not on the batch it is in.

# %%
noise = stage("gaussian_noise")
chain = Chain((stage("exposure"), noise))  # at 0 EV
alone = run(Chain((noise,)), chain.init(), photograph, key)
print("without the stage before it:", bool((run(chain, chain.init(), photograph, key) == alone).all()))
renamed = stage("gaussian_noise", name="read_noise")
other = run(renamed, renamed.init(), photograph, key)
print("under another name:", bool((other == alone).all()))

batch = np.stack(4 * [photograph])
whole = run_batch(noise, noise.init(), batch, key)
part = run_batch(noise, noise.init(), batch[:2], key, 2)
print("images 2 and 3 from a batch of two:", bool((whole[2:] == part).all()))

# %% [markdown]
# ## Domains
#
# Chains know what each stage takes, and are refused when they are built, not when they are run.

# %%
for nodes in (("mosaic", "jpeg"), ("srgb_oetf", "exposure"), ("demosaic_ahd", "demosaic_ahd")):
    try:
        Chain(tuple(map(stage, nodes)))
    except ValueError as error:
        print(error)

# %% [markdown]
# ## Nothing clips by itself
#
# Light above 1 is kept until a stage that clips: so the order of exposure and clipping matters, as in a
# camera.

# %%
bright = Chain((stage("exposure"), stage("exposure", name="back")))
values = bright.init()
values["exposure"] = type(values["exposure"])(exposure_ev=np.float32(2))
values["back"] = type(values["back"])(exposure_ev=np.float32(-2))
clipped = Chain((stage("exposure"), stage("clip"), stage("exposure", name="back")))
kept, lost = run(bright, values, photograph), run(clipped, {**clipped.init(), **values}, photograph)
print(f"up and down two stops: {abs(kept - photograph).max():.1e}")
print(f"with a clip between:   {abs(lost - photograph).max():.2f}")

# %% [markdown]
# ## Borders are reflected, in phase
#
# Without repeating the edge pixel: so that a mosaic goes on in its own pattern. A crop is therefore not
# the crop of the whole within the reach of the stages: cut at even positions, and leave a margin.

# %%
camera = Chain((stage("mosaic"), stage("demosaic_malvar")))
full = run(camera, {}, photograph)
for start in (8, 9):
    part = run(camera, {}, photograph[start : start + 40, 8:60])
    error = np.abs(part - full[start : start + 40, 8:60])
    print(f"crop at row {start}: border {error[:2].max():.3f}, inside {error[4:-4, 4:-4].max():.1e}")

# %% [markdown]
# At an odd row the crop starts at another colour of the mosaic: every pixel is then computed from other
# samples.
#
# ## Surrogate gradients
#
# Rounding has no useful slope, yet a fit needs one. Such a stage declares what it uses instead. Here is
# JPEG's quality: the true error is a staircase, the surrogate is the slope of what the staircase follows.

# %%
jpeg = stage("jpeg", subsampling="4:4:4")
Jpeg = type(jpeg.init()["jpeg"])
target = run(jpeg, {"jpeg": Jpeg(quality=np.float32(40))}, photograph)


@jax.jit
def loss(quality):
    return 1e4 * jnp.mean((jpeg({"jpeg": Jpeg(quality=quality)}, photograph) - target) ** 2)


qualities = np.linspace(20, 70, 101, dtype=np.float32)
errors, slopes = zip(*(jax.value_and_grad(loss)(q) for q in qualities))
figure, axes = plt.subplots(1, 2, figsize=(7, 2))
axes[0].plot(qualities, errors)
axes[0].set(xlabel="quality", title="error to quality 40")
axes[1].plot(qualities, np.gradient(np.array(errors), qualities), label="finite differences", linewidth=0.7)
axes[1].plot(qualities, slopes, label="declared gradient")
axes[1].set(xlabel="quality", title="slope", ylim=np.array([-1.2, 1.2]) * np.abs(slopes).max())
axes[1].legend(fontsize=7)
figure.tight_layout()

# %% [markdown]
# So finite differences do not agree with a surrogate, by intent; the sign is what counts, and it leads to
# the minimum. Which gradients are exact is in the reference, and in `jaxisp stages --json`.

# %%
from jaxisp.pipeline import sections
from jaxisp.stages import STAGES

kinds = [sections(fn)["Gradient"].split()[0].strip(".,:;") for fn in STAGES.values()]
print({kind: kinds.count(kind) for kind in sorted(set(kinds))})
