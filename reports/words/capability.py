"""Capability and risks in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .quantities import percent

if TYPE_CHECKING:
    from ..capability import Capability, Index

_REASONS = {
    "few": "fewer than 8 devices with an estimate",
    "axis": "the axes point everywhere: 3 sd exceed 90 deg",
}


def index_words(index: Index | None) -> tuple[str, str]:
    """An index and its interval; a dash where there is none, and a bound where it has no upper end."""
    if index is None or (math.isinf(index.value) and not math.isfinite(index.low)):
        return "–", ""
    low, high, value = (f"{one:.2f}".replace("-", "−") for one in (index.low, index.high, index.value))
    if math.isinf(index.value):
        return f"> {low}", "no spread beyond u"
    return value, f"> {low}" if math.isinf(index.high) else f"{low} to {high}"


def no_index(row: Capability) -> str:
    """Why a quantity has no index, or ""."""
    return _REASONS.get(row.reason, "")


def share_words(share: float | None) -> str:
    """A share in percent, or in parts per million where it is small; a dash for none."""
    if share is None or math.isnan(share):
        return "–"
    if share == 0.0:
        return "0"
    if share < 1e-9:
        return "≈ 0"
    return f"{1e6 * share:.3g} ppm" if share < 1e-4 else percent(share)
