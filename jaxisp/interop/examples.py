"""A function for `datasets.Dataset.map` of Hugging Face: a column of pictures becomes one of degraded
ones."""

from typing import Any

import numpy as np
from PIL import Image

from jaxisp.errors import InputError
from jaxisp.interop.process import MULTIPLE, Degrader
from jaxisp.recipes import RecipeLike


class DegradeExamples(Degrader):
    """`dataset.map(DegradeExamples(recipe), batched=True, with_indices=True)`.

    The picture of row i depends on the seed and on i alone, whatever the batch size.

    Args:
        recipe: as that of `IspModel`.
        image: the column of clean pictures: PIL pictures, or arrays of 8 bits or of floats in [0, 1].
        noisy: the column to write: PIL pictures of 8 bits.
        seed, multiple: as those of `IspModel`.
    """

    def __init__(
        self,
        recipe: RecipeLike,
        *,
        image: str = "image",
        noisy: str = "noisy",
        seed: int = 0,
        multiple: int = MULTIPLE,
    ) -> None:
        super().__init__(recipe, seed, multiple)
        self.image, self.noisy = image, noisy

    def __call__(
        self, examples: dict[str, list[Any]], indices: list[int] | None = None
    ) -> dict[str, list[Image.Image]]:
        """The noisy column of some rows.

        Raises:
            InputError: no such column, a row that holds no picture, or it was mapped otherwise than above.
        """
        if self.image not in examples:
            raise InputError(f"the data set has no column {self.image!r}; it has {sorted(examples)}")
        if not isinstance(examples[self.image], list) or not isinstance(indices, list):
            raise InputError("give map(..., batched=True, with_indices=True): what is drawn goes by the row")
        pictures = [_floats(p, self.image, i) for p, i in zip(examples[self.image], indices)]
        out: list[Any] = [None] * len(pictures)
        for shape in dict.fromkeys(p.shape for p in pictures):
            rows = [k for k, p in enumerate(pictures) if p.shape == shape]
            numbers = np.asarray([indices[k] for k in rows], np.int32)
            degraded = self.degrade(self.key(), np.stack([pictures[k] for k in rows]), numbers)
            for k, picture in zip(rows, np.round(255 * np.clip(degraded, 0, 1)).astype(np.uint8)):
                out[k] = Image.fromarray(picture)
        return {self.noisy: out}


def _floats(picture: Any, column: str, row: int) -> np.ndarray:
    levels = np.asarray(picture.convert("RGB") if isinstance(picture, Image.Image) else picture)
    if levels.ndim != 3 or levels.shape[-1] != 3 or levels.dtype.kind not in "uf":
        raise InputError(
            f"row {row}: {column!r} holds {levels.dtype}{levels.shape}, expected an (H, W, 3) picture"
        )
    if levels.dtype == np.uint8:
        return levels.astype(np.float32) / 255
    if levels.dtype.kind == "u":
        raise InputError(f"row {row}: {column!r} holds {levels.dtype}, expected 8 bits or floats in [0, 1]")
    return levels.astype(np.float32)
