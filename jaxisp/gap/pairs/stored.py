"""Pictures as files store them."""

import numpy as np

from jaxisp.encoder import encoder_of
from jaxisp.io import Jpeg
from jaxisp.pipeline import run


def as_stored(picture: np.ndarray, file: Jpeg | None) -> np.ndarray:
    """(H, W, 3) encoded, as a file with this one's header would have it; rounded where its encoder is not
    modelled."""
    own = encoder_of(file, original=picture)
    return np.round(255 * picture) / 255 if own is None else np.asarray(run(*own, picture))
