"""The `[raw]` table of a dataset.toml: what a mosaic without a header is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxisp.cfa import PATTERNS, XTRANS, is_xtrans
from jaxisp.errors import InputError, short


@dataclass(frozen=True)
class RawDescription:
    """`[raw]` of a dataset.toml: what a mosaic without a header is, or what overrides a header.

    `black` is one level or four (the 2x2 cell of the mosaic row by row).
    """

    cfa: str | None = None
    black: np.ndarray | None = None
    white: float | None = None
    white_balanced: bool = False
    white_balance: np.ndarray | None = None
    source: str = "dataset.toml"


def describe(table: Any, source: str) -> RawDescription:
    """A checked RawDescription of a `[raw]` table; `source` stands in errors."""
    if not isinstance(table, Mapping):
        raise InputError(f"{source}: [raw] is not a table")
    known = ("cfa", "black", "white", "white_balanced", "white_balance")
    for key in table:
        if key not in known:
            raise InputError(f"{source}: [raw] has an unknown key {key!r}, expected {', '.join(known)}")
    cfa = table.get("cfa")
    if cfa is not None and cfa not in PATTERNS and not is_xtrans(cfa):
        raise InputError(
            f"{source}: [raw] cfa = {short(cfa)}, expected one of {', '.join(PATTERNS)}, "
            f"or the 36 letters of X-Trans, as {XTRANS}"
        )
    if not isinstance(table.get("white_balanced", False), bool):
        raise InputError(f"{source}: [raw] white_balanced is not true or false")
    white = _numbers(table, "white", (1,), source)
    balance = _numbers(table, "white_balance", (3,), source)
    if balance is not None and balance.min() <= 0:
        raise InputError(f"{source}: [raw] white_balance holds gains that are not positive")
    return RawDescription(
        cfa,
        _numbers(table, "black", (1, 4), source),
        None if white is None else float(white[0]),
        table.get("white_balanced", False),
        balance,
        source,
    )


def _numbers(table: Mapping[str, Any], key: str, sizes: tuple[int, ...], source: str) -> np.ndarray | None:
    if key not in table:
        return None
    values = table[key] if isinstance(table[key], list) else [table[key]]
    # beyond 1e30 a float32 overflows; a TOML integer may have any number of digits
    fine = all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) < 1e30 for v in values)
    if not fine or len(values) not in sizes:
        raise InputError(f"{source}: [raw] {key} is not {' or '.join(map(str, sizes))} numbers")
    return np.array(values, np.float64)
