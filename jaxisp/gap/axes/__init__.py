"""Where a gap lies: the axes, their shares and the null bank."""

from collections.abc import Sequence
from typing import Any

Rows = Sequence[dict[str, Any]]
"""Axes, as `where` of report.json has them."""
