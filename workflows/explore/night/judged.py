"""Limits of a session judged: the preview while one moves, and the judgement of ``gyroscreen report --limits`` at rest.

Shapes: B devices.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from reports.acceptance import by_estimates
from reports.coded import CodedText
from reports.limits import Limits
from reports.words.explore import against_run
from reports.yields import Yield, yield_of

from ...what_if.run import judged_run
from .preview import VERDICTS, Kept, kept, p_conform, verdict_codes
from .stored import NightData, codes_of


@dataclass(frozen=True, eq=False)
class JudgedLimits:
    """The run by some limits.

    Parameters
    ----------
    limits : the limits.
    total : the yield.
    codes : (B,) verdicts as places in ``VERDICTS``.
    failed : B lists of failed quantities; ``None`` of a preview.
    p_pass : (B,) P(conform); nan where unknown.
    against_run : how the yield differs from that of the run; "" of a preview and of the limits of the run.
    """

    limits: Limits
    total: Yield
    codes: IntArray
    failed: CodedText | None
    p_pass: FloatArray
    against_run: str = ""

    @property
    def exact(self) -> bool:
        """Whether this is the judgement itself rather than a preview."""
        return self.failed is not None


def as_stored(night: NightData) -> JudgedLimits:
    """The run by its own limits, as it was stored."""
    devices = night.devices
    codes = codes_of(devices.text("verdict"), VERDICTS)
    return JudgedLimits(night.limits, night.total, codes, devices.text("failed_limits"), devices.number("p_pass"))


def judged_by(results: Path, run_id: str, limits: Limits) -> JudgedLimits:
    """The run by ``limits`` that are not its own: what ``gyroscreen report --limits`` finds.

    It reads the run again, so that a process of its own can do it.

    Raises
    ------
    ConfigError : the run knows nothing of a limited quantity.
    UsageError : no device can be judged.
    IntegrityError : a stored file is not what was committed.
    """
    found = judged_run(results, run_id, limits, "limits")
    after = found.after
    codes = codes_of(after.text("verdict"), VERDICTS)
    # The content names each device that changes its verdict; the page needs one sentence of it.
    return JudgedLimits(
        limits,
        found.content.total.new,
        codes,
        after.text("failed_limits"),
        after.number("p_pass"),
        against_run(found.content),
    )


def preview(night: NightData, limits: Limits, moving: str, before: Kept | None) -> tuple[JudgedLimits, Kept | None]:
    """The run by ``limits`` while that of ``moving`` moves, and what to pass as ``before`` next time."""
    status = night.status(limits)
    own: Kept | None = None
    if limits.rule.by_estimate:
        names = limits.quantities
        ruled = by_estimates(
            limits.rule,
            limits.limits,
            {name: night.value(name) for name in names},
            {name: night.value(f"{name}_sd") for name in names},
        )
        ok = status.equals("ok")
        codes = np.where(ok & ruled.passes, 1, np.where(ok & ruled.fails, 2, 0)).astype(np.int64)
        p = np.full(codes.size, np.nan)
    else:
        draws = night.draws(*dict.fromkeys((*limits.quantities, moving)))
        own = kept(night.weights, limits, moving, draws, before)
        limit = next((one for one in limits.limits if one.quantity == moving), None)
        p = p_conform(night.weights, limits, draws[moving], limit, own)
        codes = verdict_codes(p, limits, status)
    undecided, passed, failed = np.bincount(codes, minlength=3).tolist()
    return JudgedLimits(limits, yield_of(passed, failed, undecided), codes, None, p), own
