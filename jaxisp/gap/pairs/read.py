"""A data set read into pairs whose halves are aligned."""

import math
from collections.abc import Sequence
from typing import Any

from jaxisp.errors import InputError
from jaxisp.gap.pairs.align_clean import align_clean
from jaxisp.gap.pairs.align_raw import Aligned, align_raw
from jaxisp.gap.pairs.crops import SMALLEST, common_size, sampled
from jaxisp.gap.pairs.headers import of_one_sampling
from jaxisp.gap.pairs.own_file import with_own_file
from jaxisp.io.datasets import Dataset, Loaded


def aligned_pairs(dataset: Dataset, count: int = 0) -> Aligned:
    """The pairs of a data set, or a sample of them; what cannot be used is listed with the reason.

    Args:
        dataset: as it was opened.
        count: as how many pairs they are cut, if there are fewer: as another set is.

    Raises:
        InputError: no pair is left.
    """
    read, failed = _load(dataset.pairs)
    read, odd = of_one_sampling(read)
    failed = [(path.name, f"{path}: {reason}") for path, reason in dataset.problems] + failed + odd
    aligned = align_raw(read) if dataset.kind == "raw+jpeg" else align_clean(read)
    kept = sampled(aligned.kept, max(len(aligned.kept), count))
    sample = {
        "pairs": len(kept),
        "of_pairs": len(aligned.kept),
        "size_px": list(common_size(kept)),
        "of_size_px": list(max((pair.picture.shape[:2] for pair in read), key=math.prod)),
    }
    names = {pair.name for pair in kept}
    rows = [row for row in aligned.rows if row["name"] in names]
    return Aligned(with_own_file(kept), failed + aligned.failed, rows, sample)


def _load(pairs: Sequence[Any]) -> tuple[list[Loaded], list[tuple[str, str]]]:
    loaded, failed = [], []
    for pair in pairs:
        try:
            loaded.append(_large_enough(pair.load()))
        except InputError as error:
            failed.append((pair.name, str(error)))
    if not loaded:
        raise InputError("; ".join(reason for _, reason in failed))
    return loaded, failed


def _large_enough(pair: Loaded) -> Loaded:
    first = pair.clean if pair.raw is None else pair.raw.mosaic
    sizes = [a.shape[:2] for a in (first, pair.picture) if a is not None]
    for height, width in sizes:
        if min(height, width) < SMALLEST:
            wanted = f"{SMALLEST} or more a side"
            raise InputError(
                f"{pair.name}: {width}x{height} px are too few to be diagnosed, expected {wanted}"
            )
    return pair
