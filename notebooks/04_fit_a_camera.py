# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Fit a camera
#
# A phone that saves RAW and JPEG at once shows what its pipeline does. Fitting finds parameters with
# which the simulator makes the JPEG from the RAW. Here the phone is the package's reference phone:
# written without any of the simulator's code, so that the fit cannot win by being its own teacher.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from jaxisp import run
from jaxisp.camera import develop, params_for, with_cfa
from jaxisp.explore import Pictures, for_screen
from jaxisp.fit import fit_dataset
from jaxisp.fit.report import parameter_rows
from jaxisp.io import open_dataset
from jaxisp.samples import PHONES, scene, write_pairs

folder = Path(tempfile.mkdtemp())
write_pairs(folder, PHONES["a"], {"astronaut": scene("astronaut", (160, 192))})
pair = open_dataset(folder).pairs[0].load()
print(sorted(p.name for p in folder.iterdir()))
print(f"RAW {pair.raw.mosaic.shape}, {pair.raw.cfa}; JPEG {pair.picture.shape}")

# %% [markdown]
# Developed plainly (black level, white balance, demosaicking, colour matrix, the sRGB curve) the RAW is
# the same scene in another mood: no look, no smoothing, no sharpening.

# %%
Pictures([("RAW, developed plainly", develop(pair.raw)), ("the phone's JPEG", pair.picture)], magnify=2)

# %% [markdown]
# ## The fit
#
# Gauss-Newton steps on tiles, tone and colour first, then smoothing and sharpening, the shift between the
# two files throughout. Half of the tiles, in a checkerboard, are never fitted: the figures that count are
# theirs. Demosaicker and median filter are given here to save time; left alone, the fitter tries all.

# %%
result = fit_dataset(folder, steps=8, demosaic="demosaic_malvar", median="none")
(fitted,) = result.pairs
print(f"fitted tiles   {fitted.psnr:.2f} dB, SSIM {fitted.ssim:.3f}")
print(f"held-out tiles {fitted.held_out_psnr:.2f} dB, SSIM {fitted.held_out_ssim:.3f}")
print(f"shift {fitted.shift[0]:+.3f}, {fitted.shift[1]:+.3f} px")

figure, axes = plt.subplots(figsize=(4.5, 2))
axes.semilogy(result.losses)
axes.set(xlabel="Gauss-Newton step", ylabel="objective")
figure.tight_layout()

# %% [markdown]
# (Each phase has an objective of its own scale, hence the jumps.)
#
# ## Stage by stage
#
# The camera is a recipe with constants: a chain of ordinary stages, which can be run one at a time.
# The number is how much the last stage changed the picture (RMS, of 255).

# %%
camera = result.camera
chain, params = with_cfa(camera.chain, pair.raw.cfa), params_for(camera, pair.raw)
image, domain, shown = pair.raw.mosaic, chain.domain_in, []
for node in chain.nodes:
    image = run(node, params, image)
    domain = domain if node.domain_out.keeps else node.domain_out
    picture = np.asarray(for_screen(image, domain, pair.raw.cfa))
    change = 255 * np.sqrt(np.mean((picture - shown[-1][1]) ** 2)) if shown else np.nan
    shown.append((f"{node.name}: {change:.1f}", picture))
Pictures(shown[1:])

# %% [markdown]
# Denoising runs between `denoise_encoding` and its inverse, since noise is more even on a curved scale.
#
# ## What is left
#
# The difference, five times, about grey. Where it is structured, the simulator lacks something: see [the
# notebook on the gap](06_diagnose.py).

# %%
residual = 0.5 + 5 * (fitted.render - fitted.target)
Pictures(
    [
        ("before", fitted.start),
        ("fitted", fitted.render),
        ("the phone's", fitted.target),
        ("what is left", residual),
    ]
)

# %% [markdown]
# ## The parameters
#
# Each with the error that the curvature of the objective gives it. A parameter that these pixels cannot
# tell is named as such rather than reported with three digits.

# %%
for name, value, error, bounds in parameter_rows(result):
    if error[:1].isdigit() and len(value) < 40:
        print(f"{name:38} {value:>12}, error {error}, in {bounds}")
print("not identified by this pair:", ", ".join(result.unidentified[:8]) or "none", "...")

# %% [markdown]
# The camera is a TOML file. `jaxisp develop IMG.dng --camera camera.toml` applies it to another RAW of
# the same phone, and `jaxisp.fit.prior_from_cameras` makes a recipe of several.

# %%
camera.save(folder / "camera.toml")
print("\n".join((folder / "camera.toml").read_text().splitlines()[:12]))
