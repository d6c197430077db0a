"""What a run prints in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .quantities import percent, percent_range

if TYPE_CHECKING:
    # For annotations only: the statistics of yields take long to load.
    from ..yields import Yield


def run_sentence(run_id: str, total: Yield, identified: bool) -> str:
    """Devices, yield with its 95 % interval, and verdicts of a run."""
    counts = f"{total.passed} pass, {total.failed} fail, {total.undecided} undecided"
    if not identified:
        return f"run {run_id}: {total.devices} devices, no yield: no device could be identified ({counts})"
    interval = percent_range(total.clopper_pearson.low, total.clopper_pearson.high)
    return f"run {run_id}: {total.devices} devices, yield {percent(total.value)} (95 % interval {interval}): {counts}"
