# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Build your own stage
#
# Halation: in film, light that passes the emulsion is thrown back by the base and exposes it once more
# from behind, red first, so that bright lights get a red glow. It is not in the library. Here it is added
# in a dozen lines, with what every stage has: bounds, units, a declared gradient, a place in pipelines
# and in TOML files.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from jaxisp import Chain, Recipe, register, run, stage
from jaxisp.arrays.stencils import gaussian_blur
from jaxisp.domains import LinearRGB
from jaxisp.explore import Pictures, picture_after
from jaxisp.params import Leaf, param, parameters
from jaxisp.priors import Uniform
from jaxisp.samples import scene
from jaxisp.stages.transfer import srgb_oetf
from jaxisp.testing import check_stage

# %% [markdown]
# ## Declare it
#
# The signature is the declaration. `params` is annotated with its class, whose fields have bounds and
# units; image and return with a domain; a keyword `key` would make it stochastic; any other keyword is a
# static option, which is compiled in.
#
# Two habits to keep. A stage is *total*: a finite value and gradient for every finite input, negative
# ones too. And it never clips by itself: what is above 1 is the next stage's business.


# %%
@parameters
class Halation:
    """Strength and width of the glow."""

    amount: Leaf = param(0.3, (0.0, 2.0), "1", doc="share of the scattered light that comes back")
    sigma: Leaf = param(3.0, (0.5, 4.0), "px", log=True, doc="standard deviation of the glow")
    threshold: Leaf = param(0.6, (0.0, 1.0), "level", doc="light below this does not reach the base")


@register
def halation(params: Halation, image: LinearRGB, *, radius: int = 12) -> LinearRGB:
    """Light from above a threshold comes back blurred, most of it red.

    `y_c = x_c + amount * w_c * blur(max(luma(x) - threshold, 0))`, with w = (1, 0.3, 0.05), not clipped.

    Args:
        params: amount; sigma [px]; threshold in the unit of the image.
        image: (H, W, 3), linear light.
        radius: where the Gaussian is cut [px]; 3 times the largest sigma keeps it whole.

    Returns:
        (H, W, 3) linear light. Borders are reflected.

    Gradient: exact.

    Source: none; a tutorial's.
    """
    red, green, blue = (image[..., c] for c in range(3))
    luma = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    bright = jax.nn.relu(luma - params.threshold)
    glow = gaussian_blur(bright[..., None], params.sigma, radius)
    return image + params.amount * jnp.concatenate([glow, 0.3 * glow, 0.05 * glow], axis=-1)


# %%
photograph = np.asarray(srgb_oetf(scene("rocket", (120, 160))), np.float32)
s = stage("halation")
strong = {"halation": Halation(amount=2.0, sigma=4.0, threshold=0.3)}
Pictures(
    [
        ("scene", photograph),
        ("default", picture_after(s, photograph)),
        ("strong", picture_after(s, photograph, strong)),
    ],
    magnify=2,
)

# %% [markdown]
# ## Check the gradient
#
# Against finite differences, in double precision, along each parameter.

# %%
with jax.enable_x64(True):
    image = jnp.asarray(scene("rocket", (40, 52)), jnp.float64)
    values = {"halation": Halation(amount=0.5, sigma=2.0, threshold=0.4)}
    values = jax.tree.map(jnp.float64, values)
    total = jax.jit(lambda v: jnp.sum(s(v, image) ** 2))
    slopes = vars(jax.grad(total)(values)["halation"])
    for field, value in vars(values["halation"]).items():
        up, down = (Halation(**{**vars(values["halation"]), field: value + h}) for h in (1e-6, -1e-6))
        difference = (total({"halation": up}) - total({"halation": down})) / 2e-6
        print(
            f"{field:10} gradient {float(slopes[field]):10.5f}   finite difference {float(difference):10.5f}"
        )

# %% [markdown]
# ## Put it through the contract
#
# Every stage of the library keeps a contract, and `check_stage` puts yours through the same checks. They look
# for common traps: a NaN at black or at the bounds of a parameter, a gradient that does not arrive, a retrace
# for each new value, a batch that differs from its images, shapes or dtypes that JAX has to promote.

# %%
for name in check_stage("halation"):
    print("passed:", name.replace("_", " "))

# %% [markdown]
# ## Use it
#
# It now goes where the library's own stages go: into chains, whose domains are checked; into recipes,
# with a prior; into TOML.

# %%
film = Chain(
    (stage("srgb_eotf"), stage("halation"), stage("clip"), stage("srgb_oetf"), stage("film_grain")), "film"
)
recipe = Recipe(
    film, {"halation": Halation(amount=Uniform(0.5, 2.0), sigma=Uniform(2.0, 4.0), threshold=0.4)}
)
assert Recipe.from_toml(recipe.to_toml()) == recipe
degraded, _, drawn = recipe.degrade(jax.random.key(0), np.stack(3 * [photograph]))
Pictures(
    [
        (f"amount {a:.2f}, sigma {w:.2f} px", d)
        for a, w, d in zip(drawn["halation"].amount, drawn["halation"].sigma, degraded)
    ]
)

# %%
try:
    Chain((stage("srgb_oetf"), stage("halation")))
except ValueError as error:
    print(error)

# %% [markdown]
# ## Fit it
#
# A gradient is for fitting: how strong was the halation of a picture that somebody made? Parameters are
# moved on the real line and mapped back into their bounds, which `jaxisp.params` does from the specs.

# %%
from jaxisp.params import to_bounded, to_unbounded

light = np.asarray(scene("rocket", (60, 80)))
target = run(s, {"halation": Halation(amount=0.9, sigma=1.5, threshold=0.25)}, light)


@jax.jit
def step(free, speed):
    loss, slope = jax.value_and_grad(lambda f: jnp.mean((s(to_bounded(f), light) - target) ** 2))(free)
    speed = jax.tree.map(lambda v, g: 0.9 * v + 0.1 * g**2, speed, slope)
    return loss, jax.tree.map(lambda f, g, v: f - 0.05 * g / (jnp.sqrt(v) + 1e-9), free, slope, speed), speed


free = to_unbounded(s.init())
speed, losses = jax.tree.map(jnp.zeros_like, free), []
for _ in range(400):
    loss, free, speed = step(free, speed)
    losses.append(float(loss))
print({name: round(float(v), 3) for name, v in vars(to_bounded(free)["halation"]).items()})

figure, axes = plt.subplots(figsize=(4.5, 2))
axes.semilogy(losses)
axes.set(xlabel="step", ylabel="mean square error")
figure.tight_layout()
