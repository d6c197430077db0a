"""Yield before and after electronic tuning.

A device without a trim keeps its verdict.  Predictions come from posteriors and the uncertainty of the trim gains; the truth
is that of virtual devices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray

from ..devices import Devices
from ..limits import Limits
from ..yields import Yield, yield_of, yield_of_verdicts


@dataclass(frozen=True)
class TrimYield:
    """``before`` and ``predicted`` from verdicts; ``truth_before`` and ``truth_after`` of virtual devices, else ``None``.

    devices trimmed, how many of them with a voltage at its limit, and the median split [Hz] before and after.
    """

    before: Yield
    predicted: Yield
    truth_before: Yield | None
    truth_after: Yield | None
    trimmed: int
    at_limit: int
    split_before_hz: float
    split_after_hz: float


def true_conformity(devices: Devices, limits: Limits) -> BoolArray | None:
    """(B,) whether the truth of each virtual device conforms; ``None`` if a truth is not known."""
    checks = [devices.truth(limit) for limit in limits.limits]
    if not all(np.all(check.finite) for check in checks):
        return None
    return np.asarray(np.logical_and.reduce([check.conforms for check in checks]))


def trim_yield(devices: Devices, conforms_before: BoolArray | None) -> TrimYield | None:
    """The yields of a run with a trim, or ``None`` for a run without.

    Parameters
    ----------
    devices : the run's devices.
    conforms_before : (B,) whether the truth conforms before the trim; ``None`` for measured devices.
    """
    done = ~devices.text("trim_voltages_v").equals("")
    if not done.any():
        return None
    verdicts = devices.text("verdict")
    after = devices.text("trimmed_verdict").filled(verdicts)
    true = devices.number("trimmed_true_conforms")
    truth_before = truth_after = None
    if conforms_before is not None and np.any(np.isfinite(true)):
        kept = np.where(np.isfinite(true), true, conforms_before) > 0.5
        passed = int(np.sum(conforms_before))
        truth_before = yield_of(passed, conforms_before.size - passed)
        truth_after = yield_of(int(kept.sum()), int(kept.size - kept.sum()))
    return TrimYield(
        yield_of_verdicts(verdicts),
        yield_of_verdicts(after),
        truth_before,
        truth_after,
        int(done.sum()),
        int(np.nansum(devices.number("trim_at_limit"))),
        float(np.median(devices.number("split_hz")[done])),
        float(np.median(devices.number("trimmed_split_hz")[done])),
    )
