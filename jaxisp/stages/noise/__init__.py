"""Noise: of light, of the readout, of the sensor's own pattern, and of film.

Draws are reparameterised: for a fixed key the noise is a smooth function of the parameters, so that
gradients to them exist.
"""

from jaxisp.stages.noise.light import (
    GaussianNoise,
    PoissonNoise,
    ShotReadNoise,
    gaussian_noise,
    poisson_noise,
    shot_read_noise,
)
from jaxisp.stages.noise.patterns import (
    ColumnNoise,
    Prnu,
    RowNoise,
    column_noise,
    pattern_key,
    prnu,
    row_noise,
)
from jaxisp.stages.noise.published import LowLightNoise, ShotReadLaw, low_light_noise, shot_read_law
from jaxisp.stages.noise.texture import (
    CorrelatedNoise,
    FilmGrain,
    HeavyTailedNoise,
    correlated_noise,
    film_grain,
    heavy_tailed_noise,
)

__all__ = [
    "ColumnNoise",
    "CorrelatedNoise",
    "FilmGrain",
    "GaussianNoise",
    "HeavyTailedNoise",
    "LowLightNoise",
    "PoissonNoise",
    "Prnu",
    "RowNoise",
    "ShotReadLaw",
    "ShotReadNoise",
    "column_noise",
    "correlated_noise",
    "film_grain",
    "gaussian_noise",
    "heavy_tailed_noise",
    "low_light_noise",
    "pattern_key",
    "poisson_noise",
    "prnu",
    "row_noise",
    "shot_read_law",
    "shot_read_noise",
]
