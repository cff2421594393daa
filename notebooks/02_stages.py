# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Every stage on one photograph
#
# What there is, and what each does. Parameters carry their bounds, units and scales, which is all that is
# needed to draw sliders, to fit them, or to pick a telling value for the pictures below.

# %%
import numpy as np

from jaxisp import STAGES, Chain, stage
from jaxisp.explore import Explorer, Pictures, explore_stages, picture_after
from jaxisp.params import specs
from jaxisp.pipeline import signature
from jaxisp.samples import scene
from jaxisp.stages.transfer import srgb_oetf

photograph = np.asarray(srgb_oetf(scene("astronaut", (96, 80), (0.45, 0.1, 0.45))), np.float32)
print(f"{len(STAGES)} stages")
for name in ("bilateral", "exposure"):
    for field, spec in specs(signature(STAGES[name]).params).items():
        print(f"{name}.{field}: {spec.bounds} {spec.unit}, {spec.scale}: {spec.doc}")

# %% [markdown]
# ## The explorer
#
# A slider for each number, on a logarithmic scale where the parameter's is. The pipeline is compiled when
# it is first shown; after that a slider only runs it, so that the picture follows at once (the time is
# below it). Choose any stage from the list, or explore a chain of your own.

# %%
larger = np.asarray(srgb_oetf(scene("coffee", (160, 240))), np.float32)
explore_stages(larger)

# %%
Explorer(
    Chain((stage("mosaic"), stage("shot_read_noise"), stage("demosaic_malvar"), stage("white_balance"))),
    larger,
)

# %% [markdown]
# ## All of them
#
# Each stage at a setting that shows it: its own where one is given here, otherwise three quarters of the
# way from the default to the upper bound. The photograph is first brought into the stage's domain, and
# its result back to the screen, so that a mosaic appears with each photosite in its own colour.

# %%
TELLING = {
    "affine_exposure": {"gain": 0.4},
    "adc_quantization": {"bits": 3},
    "auto_exposure": {"target": 0.3},
    "auto_level": {"black": 5, "white": 90},
    "balanced_noise": {"shot": 0.01, "read": 0.05},
    "bilateral": {"luma_sigma_space": 3, "luma_sigma_range": 0.1, "chroma_sigma_space": 3},
    "black_level": {"offset": -0.1},
    "clip": {"white": 0.4},
    "color_matrix": {"matrix": [[1.8, -0.6, -0.2], [-0.3, 1.6, -0.3], [0.0, -0.6, 1.6]]},
    "column_noise": {"std": 0.02},
    "correlated_noise": {"std": 0.05},
    "demosaicking": {},
    "directional_blur": {"lengths": [8, 0, 0, 0]},
    "earlier_compression": {"quality": 20},
    "exposure": {"exposure_ev": 1.5},
    "film_grain": {"std": 0.06},
    "hue_rotation": {"angle": 60},
    "jpeg": {"quality": 10},
    "jpeg_photoshop": {"level": 0},
    "linearization": {"black": 0.05, "white": 0.6},
    "mosaic_white_balance": {"gains": [1.8, 1, 0.6]},
    "poisson_noise": {"gain": 0.02},
    "prnu": {"std": 0.1},
    "gaussian_noise": {"std": 0.05},
    "row_noise": {"std": 0.02},
    "s_curve": {"strength": 1.0},
    "sharpening": {"amounts": [1.5, 0, 0]},
    "shot_read_noise": {"shot": 0.01, "read": 0.03},
    "spline_curve": {"offsets": 0.1},
    "tone_curve": {"amount": -0.7},
    "vignetting": {"a2": -3.0},
    "wavelet_coring": {"luma_sigma": 0.1, "chroma_sigma": 0.1},
    "white_balance": {"gains": [1.8, 1, 0.6]},
    "white_balance_temperature": {"temperature": 3200},
}


def telling(name):
    def value(field, spec):
        if field in TELLING.get(name, {}):
            return np.broadcast_to(np.float32(TELLING[name][field]), spec.shape)
        if name in TELLING:
            return np.asarray(spec.default, np.float32)
        start, end = np.asarray(spec.default, np.float32), np.float32(spec.bounds[1])
        if spec.scale == "log":
            return start * (end / start) ** np.float32(0.75)
        return start + np.float32(0.75) * (end - start)

    chosen = signature(STAGES[name]).params
    if chosen is None:
        return {}
    return {name: chosen(**{field: value(field, spec) for field, spec in specs(chosen).items()})}


seen = set()


def row(*names):
    seen.update(names)
    return Pictures([(name, picture_after(stage(name), photograph, telling(name))) for name in names])


Pictures([("the photograph", photograph)])

# %% [markdown]
# ### Light and lens
#
# All in linear light: a lens adds up photons, not display levels.

# %%
row(
    "exposure", "affine_exposure", "vignetting", "color_shading", "lateral_chromatic_aberration",
    "geometric_distortion", "veiling_glare", "optical_blur", "defocus", "motion_blur",
    "directional_blur",
)  # fmt: skip

# %% [markdown]
# ### Sensor
#
# From here on one colour a photosite. Noise stages also take three channels.

# %%
row(
    "mosaic", "shot_read_noise", "poisson_noise", "gaussian_noise", "balanced_noise",
    "heavy_tailed_noise", "correlated_noise", "row_noise", "column_noise", "prnu", "hot_pixels",
    "dead_pixels", "defect_correction", "black_level", "linearization", "clip", "adc_quantization",
    "green_imbalance", "crosstalk",
)  # fmt: skip

# %% [markdown]
# ### Demosaicking
#
# The differences are at fine detail: here a crop, three times as large.

# %%
detail = photograph[10:42, 20:60]
names = [name for name in STAGES if name.startswith("demosaic_")]
seen.update(names)
Pictures([("the photograph", detail), *((n, picture_after(stage(n), detail)) for n in names)], magnify=3)

# %% [markdown]
# ### Colour and tone

# %%
row(
    "white_balance", "mosaic_white_balance", "white_balance_temperature", "gray_world",
    "white_patch", "color_matrix", "saturation", "hue_rotation", "selective_color", "auto_exposure",
    "auto_level", "tone_curve", "spline_curve", "zone_curve", "s_curve", "inverse_s_curve",
    "gray18_gamma", "highlight_rolloff", "local_tone_mapping", "gamma_compression",
    "gamma_expansion",
)  # fmt: skip

# %% [markdown]
# ### Smoothing, detail, files

# %%
row(
    "bilateral", "median", "wavelet_coring", "luma_denoising", "chroma_denoising",
    "color_difference_median", "unsharp_mask", "richardson_lucy", "sharpening", "resampling", "resize",
    "film_grain", "rounding", "jpeg", "jpeg_photoshop", "jpeg_tables", "earlier_compression",
    "chroma_subsampling",
)  # fmt: skip

# %% [markdown]
# ### The rest
#
# Conversions between colour spaces and encodings, which are undone for the screen, and whatever was
# registered since.

# %%
row(*sorted(set(STAGES) - seen))
