"""What the headers of files say, that one base must hold for."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from jaxisp.errors import InputError
from jaxisp.io import Raw
from jaxisp.io.datasets import Loaded
from jaxisp.io.jpeg import Jpeg
from jaxisp.io.opcodes import optical_centre
from jaxisp.stages.optics import RectilinearWarp


def stated_warp(
    raw: Raw, start: tuple[int, int] = (0, 0), shape: tuple[int, int] | None = None
) -> RectilinearWarp | None:
    """The correction of the lens that a RAW file states, for a part of its mosaic; None where it states none.

    Args:
        raw: the file.
        start: row and column of the part's first pixel.
        shape: of the part; to the mosaic's end unless given.
    """
    if raw.warp is None:
        return None
    top, left, bottom, right = raw.active_area
    centre, farthest = optical_centre(raw.warp.center, (bottom - top, right - left))
    first = np.add(raw.crop[:2], start)
    size = np.maximum(np.subtract(shape or np.subtract(raw.mosaic.shape, start), 1), 1)
    terms = raw.warp.coefficients
    terms = terms[:3] if len(terms) >= 3 else terms[:1]  # of each colour, or of all
    polynomials = np.broadcast_to(terms, (3, 6)).astype(np.float32)
    return RectilinearWarp(
        radial=polynomials[:, :4] - np.eye(1, 4, dtype=np.float32),
        tangential=polynomials[:, 4:],
        centre=np.float32((centre - first) / size),
        farthest=np.float32(2 * max(farthest, 1.0) / np.hypot(*size)),
    )


def raws_of(loaded: Sequence[Loaded]) -> tuple[list[Raw], str]:
    """The RAW of each pair, and the colour filter array that all have."""
    raws = [p.raw for p in loaded if p.raw is not None]
    cfa = raws[0].cfa
    if len(raws) < len(loaded) or any(raw.cfa != cfa for raw in raws):
        raise InputError("the RAW files have different colour filter arrays; diagnose one camera at a time")
    return raws, cfa


def of_one_sampling(loaded: Sequence[Loaded]) -> tuple[list[Loaded], list[tuple[str, str]]]:
    """The pairs whose chroma is sampled as that of most is, and (name, reason) of the others: where the base
    stores its pictures the header decides. Of as many the first's."""
    stated = [_sampling(pair) for pair in loaded]
    usual = Counter(stated).most_common(1)[0][0]
    odd = [
        (pair.name, f"{pair.name}: is of another kind ({own}) than most ({usual}); diagnose them apart")
        for pair, own in zip(loaded, stated)
        if own != usual
    ]
    return [pair for pair, own in zip(loaded, stated) if own == usual], odd


def _sampling(pair: Loaded) -> str:
    if pair.jpeg is None:
        return "no JPEG"
    kind = f"JPEG, {pair.jpeg.subsampling}" + ", RGB" * (pair.jpeg.color_space == "RGB")
    return kind + ", in another colour space than sRGB" * pair.jpeg.converted


def stated_by(file: Jpeg | None) -> set[str]:
    """The effects that a file's header tells all about, and that are not looked for."""
    if file is None:
        return set()
    return {"jpeg_quantization"} | ({"chroma_subsampling"} if file.subsampling != "4:4:4" else set())
