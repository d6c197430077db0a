"""Sentences about a night in which no device could be identified."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..run.health import StatusCount


def status_cause(statuses: Sequence[StatusCount]) -> str | None:
    """The most frequent status and its reason, in words; ``None`` without devices."""
    if not statuses:
        return None
    first = max(statuses, key=lambda row: row.devices)
    reason = f": {first.reason}" if first.reason else ""
    return f"{first.devices} of {sum(row.devices for row in statuses)} devices {first.status.replace('_', ' ')}{reason}"
