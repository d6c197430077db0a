"""Noise of frequency-domain records, measured without a model of the device.

    sd = standard deviation of the real part, and of the imaginary part, of one row and channel [V]

It comes from the first of these sources that is available:

    "declared"  the records state it (an sd, or a coherence)
    "repeats"   rows of several passes over the same frequencies, at one level and in one direction, less a local fit
    "local"     neighbouring rows of one pass, less a local fit
    "residual"  the local fit leaves more than noise nearly everywhere, so it only bounds the level

The local fit is rational over a window of W rows in the order of frequency, x in [-1, 1]:

    (1 + a x) Y = b_0 + b_1 x + b_2 x^2         exact for one resonance on a background; linear in a, b_k

Its residual power v per free complex coefficient, over the mean of |1 + a x|^2, is 2 sd^2 times a gamma variable of shape W - 4
in quiet windows and more elsewhere (jumps, several resonances); ``local.quiet_level`` takes the level from the quiet ones.
Passes that differ, such as by a drift, add power where the response is steep, so that the quiet windows are those away from the
resonances.  Source: McKelvey and Guerin, IFAC Proc. 45-16 (2012) 716 (local rational method).

Shapes: N rows, S senses, K windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from ...arrays import ComplexArray, FloatArray
from ...errors import MeasurementError
from ..tones import SweepPass, ToneRecord, passes_of
from .local import log_covariance, quiet_level

ToneNoiseSource = Literal["declared", "repeats", "local", "residual"]

#: Unknowns of the local fit; rows of a window of a single pass, which must be short beside a resonance, and at most of several.
_ORDER, _SHORT, _LONG = 4, 8, 16
#: Tail probability above which a window is not quiet.
_TAIL = 1e-3
#: Fewest windows that show a level.
_FEWEST = 5


@dataclass(frozen=True, eq=False)
class ToneNoise:
    """Noise of all records.

    Parameters
    ----------
    sd_v : for each record (N, S) sd of the real and of the imaginary part [V].
    source : the weakest of the sources of the records.
    dof : degrees of freedom of the levels together.
    """

    sd_v: tuple[FloatArray, ...]
    source: ToneNoiseSource
    dof: int

    @property
    def known(self) -> bool:
        """Whether the level was measured; else it is only bounded."""
        return self.source != "residual"

    @property
    def independent(self) -> bool:
        """Whether errors in units of the level are given: it does not rest on the smoothness of the response alone."""
        return self.source in ("declared", "repeats")

    @property
    def sigma_v(self) -> FloatArray:
        """(S,) rms of the sd of all rows [V]."""
        return np.asarray(np.sqrt(np.mean(np.concatenate(self.sd_v) ** 2, axis=0)))


def tone_noise(records: tuple[ToneRecord, ...]) -> ToneNoise:
    """The noise of ``records``.

    Raises
    ------
    MeasurementError : too few rows for a local fit, or a channel without noise.
    """
    passes = passes_of(records)
    sd = [np.full(record.sense_v.shape, np.nan) if record.sd_v is None else record.sd_v for record in records]
    order: tuple[ToneNoiseSource, ...] = ("declared", "repeats", "local", "residual")
    rank, dof = 0, 0
    for own in _groups(records, passes):
        rows, width, repeated = _windows(records, own)
        v = _window_variances(records, rows, width) / 2.0
        quiet = True
        for channel, each in enumerate(v.T):
            level, measured = quiet_level(each, width - _ORDER)
            shape = width - _ORDER
            if measured:
                # The mean of the quiet windows is more certain than their median.
                level = float(np.mean(each[each < level * gammainccinv(shape, _TAIL) / shape]))
            else:
                level = float(np.median(each) / (gammaincinv(shape, 0.5) / shape))
            quiet = quiet and measured
            for one in own:
                sd[one.record][one.rows, channel] = np.sqrt(level)
        rank = max(rank, 3 if not quiet else 1 if repeated else 2)
        dof += int(2.0 / log_covariance(v.shape[0], width - _ORDER)[1, 1])
    if not all(np.all(np.isfinite(each) & (each > 0.0)) for each in sd):
        raise MeasurementError(
            "a sense channel has no noise",
            value=[record.name for record in records],
            allowed="an sd above 0 in every channel",
            next_step="declare sense<k>_sd_V (or H_s<k>d<k>_sd) under [columns]",
        )
    if rank == 0:
        dof = 2 * sum(each.size for each in sd)
    return ToneNoise(tuple(sd), order[rank], dof)


def _groups(records: tuple[ToneRecord, ...], passes: Sequence[SweepPass]) -> list[list[SweepPass]]:
    """Passes that share a level of the noise: those of one kind, level and drive, unless their sd is declared."""
    groups: dict[tuple[object, ...], list[SweepPass]] = {}
    for one in passes:
        if records[one.record].sd_v is None:
            groups.setdefault((records[one.record].kind, one.level, one.drives), []).append(one)
    every = list(groups.values())
    if any(sum(one.stop - one.first for one in own) < _FEWEST * _SHORT for own in every):
        joined = [one for own in every for one in own]
        if sum(one.stop - one.first for one in joined) < _FEWEST * _SHORT:
            raise MeasurementError(
                "the noise level could not be measured: the sweep has too few rows",
                value=sum(one.stop - one.first for one in joined),
                allowed=f"at least {_FEWEST * _SHORT} rows",
                next_step="declare the noise (sense1_sd_V under [columns]), or measure more frequencies",
            )
        return [joined]
    return every


def _windows(
    records: tuple[ToneRecord, ...], own: Sequence[SweepPass]
) -> tuple[list[list[tuple[int, int]]], int, bool]:
    """Windows of (record, row) in the order of frequency, their width, and whether each holds rows of several passes."""
    tracks: dict[tuple[float, str, str], list[SweepPass]] = {}
    for one in own:
        tracks.setdefault((one.level, one.direction, one.drives), []).append(one)
    repeated = all(len(track) > 1 for track in tracks.values())
    fewest = min(len(track) for track in tracks.values())
    width = min(_SHORT // 2 * fewest, _LONG) if repeated else _SHORT
    windows = []
    for track in tracks.values():
        for members in [track] if repeated else [[one] for one in track]:
            rows = [(one.record, i) for one in members for i in range(one.first, one.stop)]
            rows.sort(key=lambda row: float(records[row[0]].frequency_hz[row[1]]))
            windows += [rows[i : i + width] for i in range(0, len(rows) - width + 1, width)]
    return windows, width, repeated


def _window_variances(
    records: tuple[ToneRecord, ...], windows: Sequence[Sequence[tuple[int, int]]], width: int
) -> FloatArray:
    """v (K, S) [V^2]: residual power per free complex coefficient, of the response to the drive of each row."""
    out = []
    for rows in windows:
        f = np.array([records[k].frequency_hz[i] for k, i in rows])
        y = np.array([records[k].sense_v[i] for k, i in rows])
        x = 2.0 * (f - f.min()) / max(float(np.ptp(f)), 1e-300) - 1.0
        out.append([_left(x, each, width) for each in y.T])
    return np.array(out)


def _left(x: FloatArray, y: ComplexArray, width: int) -> float:
    """Residual power of the local fit to y (W,) at x (W,), per free coefficient [V^2]."""
    columns = np.stack([np.ones_like(y), x, x**2, -x * y], axis=1)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    inverse = np.linalg.pinv(columns / size, rcond=1e-12)
    found = inverse @ y
    left = float(np.sum(np.abs(y - (columns / size) @ found) ** 2)) / (width - _ORDER)
    # |1 + a x|^2 with the square of a, less what the noise adds to it.
    a, spread = found[-1] / size[-1], left * float(np.sum(np.abs(inverse[-1]) ** 2)) / size[-1] ** 2
    grown = max(abs(a) ** 2 - spread, 0.0) / max(abs(a) ** 2, 1e-300)
    weight = np.mean(1.0 + 2.0 * np.sqrt(grown) * a.real * x + grown * abs(a) ** 2 * x**2)
    return float(left / weight)
