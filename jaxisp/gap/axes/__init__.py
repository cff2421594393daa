"""The axes along which a gap lies, the share of each, and the null bank."""

from collections.abc import Sequence
from typing import Any

Rows = Sequence[dict[str, Any]]
"""Rows of `where` in report.json, one for each axis."""
