"""What a trend keeps of a night: its yield, and the mean of each quantity with its interval.

Means are over the devices that were identified.

Shapes: B devices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from pipeline.arrays import BoolArray, FloatArray

from ..clusters import effective_number
from ..coded import IntArray
from ..devices import Devices
from ..yields import LEVEL, Interval, clopper_pearson
from .charted import COMPONENTS


@dataclass(frozen=True, eq=False)
class Grouping:
    """Groups of devices that are independent draws of the process: ``by`` "lot", "wafer" or "device", and each device's (B,)."""

    by: str
    index: IntArray

    @property
    def groups(self) -> int:
        """Number of groups."""
        return int(np.unique(self.index).size)

    def of(self, rows: BoolArray) -> Grouping:
        """The groups of ``rows`` (B,) alone."""
        return Grouping(self.by, self.index[rows])


@dataclass(frozen=True)
class Mean:
    """A mean, its standard error and degrees of freedom, over ``groups`` groups ``by``."""

    value: float
    se: float
    df: float
    by: str
    groups: int

    def interval(self, level: float = LEVEL) -> tuple[float, float]:
        """Student interval; unbounded where the scatter is not known."""
        if not np.isfinite(self.se):
            return -np.inf, np.inf
        half = float(stdtrit(self.df, 0.5 * (1.0 + level))) * self.se
        return self.value - half, self.value + half


@dataclass(frozen=True)
class NightSummary:
    """What a chart needs of a night: its yield with the interval, and the mean of each quantity; no device by itself."""

    run_id: str
    created: str
    devices: int
    passed: int
    interval: Interval
    means: Mapping[str, Mean]

    @property
    def share(self) -> float:
        """The yield: passed / devices."""
        return self.passed / self.devices if self.devices else float("nan")


@dataclass(frozen=True, eq=False)
class Night:
    """A night: the values (B,) of each quantity (nan where not identified), what passed (B,), and the groups of its devices.

    ``identified``: whether any device was.  ``device_id`` is empty where it was not asked for.
    """

    run_id: str
    created: str
    device_id: tuple[str, ...]
    passed: BoolArray
    values: Mapping[str, FloatArray]
    grouping: Grouping
    identified: bool = True

    @property
    def devices(self) -> int:
        """Number of devices, identified or not."""
        return int(self.passed.size)

    @property
    def share(self) -> float:
        """The yield: passed / devices."""
        return float(self.passed.mean()) if self.passed.size else float("nan")

    def mean(self, name: str) -> Mean:
        """The mean of a quantity."""
        return grouped_mean(self.values[name], self.grouping)

    def summary(self, names: Sequence[str]) -> NightSummary:
        """The summary with the means of the quantities ``names``."""
        means = {name: self.mean(name) for name in names}
        return NightSummary(
            self.run_id, self.created, self.devices, int(self.passed.sum()), self.yield_interval(), means
        )

    def yield_interval(self, level: float = LEVEL) -> Interval:
        """Interval of the yield of the process at this night."""
        return share_interval(self.passed, self.grouping, level)


def night_of(devices: Devices, run_id: str, created: str, quantities: Sequence[str], identities: bool = False) -> Night:
    """The night in a ``devices`` table; ``identities``: with the device ids, which pairs need."""
    ok = devices.is_ok()
    values = {name: np.where(ok, values_of(devices, name), np.nan) for name in quantities}
    ids = tuple(devices.text("device_id")) if identities else ()
    return Night(run_id, created, ids, devices.has("pass"), values, grouping(devices), devices.identified())


def values_of(devices: Devices, name: str) -> FloatArray:
    """(B,) estimates of a quantity or of a component of the anisotropy vector, in its unit."""
    if name not in COMPONENTS:
        return devices.number(name)
    twice = np.radians(2.0 * devices.number("theta_deg"))
    split = devices.number("split_hz")
    return np.asarray(split * (np.cos(twice) if name == COMPONENTS[0] else np.sin(twice)))


def grouping(devices: Devices) -> Grouping:
    """Lots where there are two or more and all are known, else wafers, else single devices."""
    for by, names in (("lot", devices.text("lot")), ("wafer", devices.wafers())):
        found = names.counts()
        if len(found) > 1 and all(found):
            return Grouping(by, names.codes)
    return Grouping("device", np.arange(len(devices), dtype=np.int64))


def grouped_mean(values: FloatArray, by: Grouping) -> Mean:
    """Mean of the finite ``values`` (B,), groups drawn at random:

        var(mean) = G / (G - 1) sum_g (sum_{i in g} (x_i - mean))^2 / n^2,    G - 1 degrees of freedom

    Cochran 1977, Sampling Techniques, ch. 9 (ratio estimator of clusters of unequal size).
    """
    known = np.isfinite(values)
    n = int(known.sum())
    if n == 0:
        return Mean(float("nan"), float("nan"), 0.0, by.by, 0)
    x = values[known]
    present, index = np.unique(by.index[known], return_inverse=True)
    g, mean = present.size, float(x.mean())
    if g < 2:
        return Mean(mean, float("inf"), 0.0, by.by, g)
    total = np.bincount(index, weights=x - mean, minlength=g)
    return Mean(mean, float(np.sqrt(g / (g - 1.0) * np.sum(total**2)) / n), g - 1.0, by.by, g)


def share_interval(passed: BoolArray, by: Grouping, level: float = LEVEL) -> Interval:
    """Interval of a share with whole groups as draws (Korn and Graubard 1998; see ``reports.clusters``)."""
    if passed.size == 0:
        return Interval(0.0, 1.0, "no devices", level)
    present, index = np.unique(by.index, return_inverse=True)
    x = passed.astype(np.float64)
    if present.size in (1, passed.size):
        return clopper_pearson(float(x.sum()), float(x.size), level)
    found = effective_number(x, index, int(present.size), level)
    return clopper_pearson(found.share * found.effective, found.effective, level)
