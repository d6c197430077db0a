"""Bins of devices, for STDF and wafer maps.

| hardware bin | devices |
|---|---|
| 1 | pass |
| 2 | fail |
| 3 | undecided: identified, but too close to a limit |
| 4 | not identified: status other than ok |

| software bin | devices |
|---|---|
| 1, 3 | pass, undecided |
| 4, 5, 6, 7 | not_converged, fit_failed, misfit, lost |
| 9 | fail, by no single limit |
| 10 + k | fail, first by limit k in the order of the limits |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..coded import IntArray
from ..devices import Devices
from ..limits import Limit, Limits

HARD_NAMES = {1: "pass", 2: "fail", 3: "undecided", 4: "not identified"}
#: Of a hardware bin: "P" passing, "F" failing, " " neither.
PASSING = {1: "P", 2: "F", 3: " ", 4: " "}
_STATUS = {"not_converged": 4, "fit_failed": 5, "misfit": 6, "lost": 7}
_FAIL, _FIRST_LIMIT = 9, 10


@dataclass(frozen=True, eq=False)
class Bins:
    """(B,) hardware and software bin of each device, and the names of the software bins."""

    hard: IntArray
    soft: IntArray
    soft_names: dict[int, str]

    def passing(self, soft: int) -> str:
        """ "P", "F" or " " of a software bin."""
        return "P" if soft == 1 else "F" if soft >= _FAIL else " "


def bins_of(devices: Devices, limits: Limits) -> Bins:
    """The bins of all devices of a run."""
    identified = devices.is_ok()
    hard = np.where(devices.has("pass"), 1, np.where(devices.has("fail"), 2, np.where(identified, 3, 4)))
    soft = np.where(hard == 2, _FAIL, hard)
    status = devices.text("status")
    for name, number in _STATUS.items():
        soft[(hard == 4) & status.equals(name)] = number
    failed = devices.text("failed_limits")
    order = {limit.quantity: _FIRST_LIMIT + k for k, limit in enumerate(limits.limits)}
    firsts = [min((order[name] for name in word.split(",") if name in order), default=_FAIL) for word in failed.words]
    soft = np.where(hard == 2, np.array(firsts, dtype=np.int64)[failed.codes], soft)
    names = {1: "pass", 3: "undecided", _FAIL: "fail"} | {number: name for name, number in _STATUS.items()}
    names |= {_FIRST_LIMIT + k: _words(one) for k, one in enumerate(limits.limits)}
    return Bins(hard.astype(np.int64), soft.astype(np.int64), names)


def _words(limit: Limit) -> str:
    """A limit in ASCII: "split_hz max 3"."""
    ends = (("min", limit.low), ("max", limit.high))
    return " ".join([limit.quantity, *(f"{name} {end:g}" for name, end in ends if math.isfinite(end))])
