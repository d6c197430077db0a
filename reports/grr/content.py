"""What the page of a gauge R&R shows: for each quantity the study, its measurements, and the cells of AIAG's charts.

    cell         the measurements of one part by one tester: mean m of n
    repeats      their sd s within sessions, nu = sum over sessions of (n_session - 1)
    chart of s   centre c4 sigma, ends c4 sigma +- 3 sigma sqrt(1 - c4^2), not below 0
                 c4(nu) = sqrt(2/nu) G((nu+1)/2) / G(nu/2)
    chart of m   mean +- 3 sigma / sqrt(n)
    sigma        repeatability of the study

The range chart of AIAG needs equally many repeats in each cell; the chart of s does not.

Shapes: N measurements, C cells.
Source: AIAG, Measurement Systems Analysis, 4th ed. (2010), ch. III B; Montgomery, Statistical Quality Control, 7th ed. (2013),
ch. 6.3.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from pipeline.arrays import FloatArray, IntArray

from ..gauge import GaugeData, GaugeStudy, unwrapped
from ..limits_origin import LimitsOrigin


@dataclass(frozen=True, eq=False)
class GaugeCells:
    """C cells, tester by tester: part, tester, mean and count of the measurements; sd and degrees of freedom of the repeats.

    ``sd`` is nan where nothing is repeated within a session (``df`` 0).
    """

    part: IntArray
    tester: IntArray
    mean: FloatArray
    count: IntArray
    sd: FloatArray
    df: IntArray


@dataclass(frozen=True, eq=False)
class GaugeChart:
    """A quantity: its study, N measurements ``data`` without gaps, the cells, and the names of parts and testers."""

    study: GaugeStudy
    data: GaugeData
    cells: GaugeCells
    parts: tuple[str, ...]
    testers: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class GaugeContent:
    """The page: the run, the charts, and where the limits of % tolerance came from."""

    run_id: str
    charts: tuple[GaugeChart, ...]
    limits: LimitsOrigin


def gauge_chart(
    study: GaugeStudy, data: GaugeData, parts: Sequence[str], testers: Sequence[str], axis: bool
) -> GaugeChart:
    """The chart of a study.

    Parameters
    ----------
    study, data : as of :func:`reports.gauge.gauge_study`; nan are left out.
    parts, testers : the names of the numbers in ``data``.
    axis : the quantity is an angle modulo 180 deg.
    """
    known = np.isfinite(data.value)
    value = unwrapped(data.value[known], data.part[known]) if axis else data.value[known]
    part, part_names = _by_name(data.part[known], parts)
    tester, tester_names = _by_name(data.tester[known], testers)
    own = GaugeData(value, part, tester, data.session[known])
    return GaugeChart(study, own, cells_of(own), part_names, tester_names)


def cells_of(data: GaugeData) -> GaugeCells:
    """The cells of measurements without gaps, tester by tester."""
    pairs, cell = np.unique(np.stack([data.tester, data.part], 1), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    count = np.bincount(cell)
    mean = np.bincount(cell, data.value) / count
    within, group = np.unique(np.stack([cell, data.session], 1), axis=0, return_inverse=True)
    group = group.reshape(-1)
    size = np.bincount(group)
    squares = np.bincount(group, (data.value - (np.bincount(group, data.value) / size)[group]) ** 2)
    df = np.bincount(within[:, 0], size - 1).astype(np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        sd = np.sqrt(np.bincount(within[:, 0], squares) / df)
    return GaugeCells(pairs[:, 1], pairs[:, 0], mean, count.astype(np.int64), np.where(df > 0, sd, np.nan), df)


def sd_limits(sigma: float, df: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lower limit, centre and upper limit (C,) of the sd of repeats with ``df`` degrees of freedom; nan where that is 0."""
    nu = np.where(df > 0, df, np.nan).astype(np.float64)
    c4 = np.sqrt(2.0 / nu) * np.exp(gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu))
    spread = 3.0 * sigma * np.sqrt(1.0 - c4**2)
    return np.maximum(c4 * sigma - spread, 0.0), c4 * sigma, c4 * sigma + spread


def mean_limits(study: GaugeStudy, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limit (C,) of the means of ``count`` measurements, if parts did not differ."""
    half = 3.0 * study.component("repeatability").sd.value / np.sqrt(count)
    return study.mean - half, study.mean + half


def _by_name(codes: IntArray, names: Sequence[str]) -> tuple[IntArray, tuple[str, ...]]:
    """``codes`` numbered in the order of their names, and those names that occur; numbers in names count as numbers."""
    present = sorted({int(code) for code in codes}, key=lambda code: _natural(names[code]))
    place = np.zeros(max(present, default=0) + 1, dtype=np.int64)
    place[present] = np.arange(len(present))
    return place[codes], tuple(names[code] for code in present)


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """A key by which A2 comes before A10."""
    pieces = re.split(r"(\d+)", name)
    return tuple((1, int(piece), "") if piece.isdecimal() else (0, 0, piece) for piece in pieces)
