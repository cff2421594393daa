# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Diagnose a gap
#
# A simulated camera never matches the real one entirely. Which effect does it lack? `diagnose` compares
# the two on RAW+JPEG pairs, tries each effect of a library, and measures on pairs that it did not fit how
# much of the gap each closes.
#
# Here the real camera has a look that the library does not know: split toning, shadows towards teal,
# highlights towards orange.

# %%
import tempfile
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

from jaxisp import register, stage
from jaxisp.domains import EncodedRGB
from jaxisp.explore import Pictures, picture_after
from jaxisp.gap import EFFECTS, Effect, Move, diagnose, register_effect
from jaxisp.gap.report.axes import ACROSS
from jaxisp.io import read_image, write_png
from jaxisp.params import Leaf, param, parameters
from jaxisp.samples import PHONES, scene, scene_names, write_pairs

folder = Path(tempfile.mkdtemp())
names = write_pairs(folder, PHONES["a"], {name: scene(name, 128) for name in scene_names()})
toned = {}
for name in names:
    picture = np.asarray(read_image(folder / f"{name}.jpg"), np.float32)
    (folder / f"{name}.jpg").unlink()
    luma = picture @ np.float32([0.299, 0.587, 0.114])
    toned[name] = picture + 0.25 * ((luma - 0.5) * luma * (1 - luma) * 4)[..., None] * np.float32([1, 0, -1])
    write_png(folder / f"{name}.png", np.clip(toned[name], 0, 1))
Pictures(toned.items())

# %% [markdown]
# ## An effect of your own
#
# An effect is a stage, where it goes, and how its parameters may move. The stage must do nothing at
# `off`. It need not be what the camera really does, only something like it: this one knows nothing of the
# formula above.


# %%
@parameters
class SplitToning:
    amount: Leaf = param(0.0, (-1.0, 1.0), "1", doc="highlights towards orange, shadows towards teal")


@register
def split_toning(params: SplitToning, image: EncodedRGB) -> EncodedRGB:
    luma = image.mean(-1, keepdims=True)
    return image + 0.5 * params.amount * jax.numpy.sin(2 * np.pi * (luma - 0.5)) * np.float32([1, 0, -1])


register_effect(
    Effect(
        "split_toning", stage("split_toning"), "encoded", (Move("amount", 0.1, -1, 1),), ("hue", "intensity")
    )
)
Pictures(
    (
        f"amount {a}",
        picture_after(
            stage("split_toning"), toned["coffee"], {"split_toning": SplitToning(amount=np.float32(a))}
        ),
    )
    for a in (-0.3, 0.0, 0.3)
)

# %% [markdown]
# ## The diagnosis
#
# All effects compete. To save time, those that cannot change colour are left out here; `diagnose(folder)`
# tries all.

# %%
kept = {
    "split_toning",
    "color_lut",
    "color_matrix",
    "saturation",
    "tone_curve",
    "white_balance",
    "vignetting",
    "color_shading",
    "sharpening",
}
found = diagnose(folder, exclude=sorted(set(EFFECTS) - kept))
print("verdict:", found.verdict, found.causes)
for row in found.report["ranking"]:
    print(f"{row['effect']:18} closes {100 * row['closed']:6.1f} %  {row['status']}")

# %%
gap = found.report["gap"]
print(f"gap {gap['before']:.1f} -> {gap['after']:.1f}, floor {gap['floor']:.1f} ({gap['metric'][:40]}...)")
for cause in found.report["causes"]:
    share, low, high = (100 * v for v in (cause["closed"], *cause["ci"]))
    print(f"{cause['effect']}: {share:.0f} % [{low:.0f}, {high:.0f}], {cause['params']}")

# %% [markdown]
# ## Where it shows
#
# The residual before any effect is added, along the axes that explain most of it. A toning that turns its
# sign in the middle of the scale is easily read off the intensity. The page that `found.save` writes begins
# with a map of the differences in a held-out picture.

# %%
shown = [w for w in found.report["where"] if len(w["bins"]) > 3][:3]
figure, axes = plt.subplots(1, len(shown), figsize=(9, 2.6), squeeze=False)
for w, axis in zip(shown, axes[0]):
    numbers = not isinstance(w["bins"][0], str)
    axis.plot(w["bins"] if numbers else range(len(w["bins"])), w["profile"])
    if not numbers:
        axis.set_xticks(range(len(w["bins"])), w["bins"], fontsize=7)
    axis.axhline(0, color="gray", linewidth=0.7)
    axis.set_title(f"{100 * w['share']:.0f} % of the gap", fontsize=9)
    axis.set_xlabel(ACROSS.get(w["axis"], w["axis"]), fontsize=8)
    axis.set_ylabel(f"{w['channel']}, {w['unit'].split(',')[0]} [8-bit steps]", fontsize=8)
figure.tight_layout()

# %% [markdown]
# `found.save(DIR)` writes the whole as a page and as JSON; `jaxisp diagnose PAIRS -o DIR` does the same
# from the command line.
#
# For real use, write the stage with its docstring as in [the notebook on stages](03_your_own_stage.py), so
# that `jaxisp.testing.check_stage` accepts it.
