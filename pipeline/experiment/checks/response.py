"""Poles and residues of the response in the driven band, without a model of the device.

    Y_i(w) = sum_j (sum_p r_pij / (j w - p) + smooth_ij(w)) U_j(w) + start_i(w) - end_i(w) exp(-j w T)
    start, end = sum_p c_p / (j w - p) + smooth(w)

exact for linear modes and records of any length T: what rings before the start and after the end is in the
last two terms.  The poles come first, from a rational fit with a common denominator (Sanathanan-Koerner),
then the rest is linear.

Shapes: P poles, S senses, D drives, R records, K bins.  Residues [1/s] are those of the samples, hold,
filter, delay and converter included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.fft import rfft

from ...arrays import BoolArray, ComplexArray, FloatArray
from ..record import Record

_ITERATIONS = 10
_MAX_SAMPLES = 2**16
_MAX_RECORDS = 4
#: Bins with less than this share of the strongest drive power are left out.
_DRIVEN = 1e-3
#: Half the width of the band around the centre of the response, relative.
_BAND = 0.3
_SMOOTH = 3


@dataclass(frozen=True, eq=False)
class Response:
    """What the band holds.

    poles (P,) [rad/s]; residues (P, S, D) [1/s] with covariance (S, P*D, P*D); start (R, P, S) initial
    amplitudes [V] with start_sd; relative_error of the fit in the band; records: names of those used.
    """

    poles: ComplexArray
    residues: ComplexArray
    covariance: ComplexArray
    start_v: ComplexArray
    start_sd_v: FloatArray
    relative_error: float
    records: tuple[str, ...]

    def summed(self, which: list[int]) -> tuple[ComplexArray, FloatArray]:
        """Sum (S, D) of the residues of some poles and the sd (S, D) of its real or imaginary part."""
        drives = self.residues.shape[2]
        total = self.residues[which].sum(axis=0)
        sd = np.empty(total.shape)
        for j in range(drives):
            at = [p * drives + j for p in which]
            block = self.covariance[:, at][:, :, at]
            sd[:, j] = np.sqrt(np.maximum(np.real(block.sum(axis=(1, 2))), 0.0) / 2.0)
        return total, sd


@dataclass(frozen=True, eq=False)
class _DrivenBand:
    """Spectra of one record at the frequencies used: w (K,) [rad/s], U (K, D), Y (K, S)."""

    w: FloatArray
    U: ComplexArray
    Y: ComplexArray
    duration_s: float


def _smoothed(power: FloatArray, width: int) -> FloatArray:
    return np.convolve(power, np.ones(width) / width, mode="same")


def _spectra(record: Record, padded: int, band_hz: tuple[float, float]) -> _DrivenBand:
    count = min(record.drive_v.shape[0], _MAX_SAMPLES)
    drive = record.drive_v[:count]
    sense = record.sense_v[:count] - record.sense_v[:count].mean(axis=0)
    size = padded * count
    w = 2.0 * np.pi * np.arange(size // 2 + 1) * record.sample_rate_hz / size
    keep = (w >= 2.0 * np.pi * band_hz[0]) & (w <= 2.0 * np.pi * band_hz[1])
    return _DrivenBand(
        w[keep], rfft(drive, size, axis=0)[keep], rfft(sense, size, axis=0)[keep], count / record.sample_rate_hz
    )


def band_hz(records: list[Record]) -> tuple[float, float] | None:
    """Driven band around the centre of the response; ``None`` where nothing is driven."""
    edges = []
    for record in records:
        full = _spectra(record, 1, (0.0, record.sample_rate_hz / 2.0))
        hz, width = full.w / (2.0 * np.pi), max(3, round(10.0 * full.duration_s) | 1)
        drive = _smoothed(np.sum(np.abs(full.U) ** 2, axis=1), min(width, max(hz.size // 8, 1)))
        driven: BoolArray = (drive > _DRIVEN * drive.max()) & (hz > 0.0)
        response = np.where(driven, np.sum(np.abs(full.Y) ** 2, axis=1), 0.0)
        if not response.any():
            continue
        centre = float(np.sum(hz * response) / np.sum(response))
        near = hz[driven & (np.abs(hz - centre) < _BAND * centre)]
        if near.size:
            edges.append((float(near[0]), float(near[-1])))
    return (min(low for low, _ in edges), max(high for _, high in edges)) if edges else None


def _denominator(bands: list[_DrivenBand], order: int, centre: float, half: float) -> ComplexArray | None:
    """Chebyshev coefficients (order + 1,) of A in A Y = B U + T, by repeated weighted least squares."""
    senses = bands[0].Y.shape[1]
    x = [(band.w - centre) / half for band in bands]
    bases = [chebyshev.chebvander(part, order + 1) for part in x]
    rows = np.cumsum([0, *[part.size for part in x]])
    drives, terms = bands[0].U.shape[1], order + 2
    regressors = np.zeros((rows[-1], drives * terms + len(bands) * terms), dtype=np.complex128)
    powers = np.zeros((senses, rows[-1], order + 1), dtype=np.complex128)
    for r, (band, basis) in enumerate(zip(bands, bases)):
        at = slice(rows[r], rows[r + 1])
        for j in range(drives):
            regressors[at, j * terms : (j + 1) * terms] = basis * band.U[:, j, None]
        transient = (drives + r) * terms
        regressors[at, transient : transient + terms] = basis * np.sqrt(np.mean(np.abs(band.U) ** 2))
        for i in range(senses):
            scale = np.sqrt(np.mean(np.abs(band.Y[:, i]) ** 2))
            powers[i, at] = basis[:, : order + 1] * band.Y[:, i, None] / (scale if scale > 0.0 else 1.0)
    values = np.concatenate(bases)[:, : order + 1]
    weight = np.ones(rows[-1])
    a = np.zeros(order + 1, dtype=np.complex128)
    for _ in range(_ITERATIONS):
        q, _r = np.linalg.qr(regressors * weight[:, None])
        left = [part * weight[:, None] - q @ (q.conj().T @ (part * weight[:, None])) for part in powers]
        stacked = np.concatenate(left)
        solution = np.linalg.lstsq(stacked[:, :order], -stacked[:, order], rcond=None)[0]
        a = np.append(solution, 1.0)
        size = np.abs(values @ a)
        if not np.all(np.isfinite(size)) or size.max() == 0.0:
            return None
        weight = 1.0 / np.maximum(size, 1e-9 * size.max())
        weight /= weight.max()
    return a


def _poles(bands: list[_DrivenBand], order: int) -> ComplexArray | None:
    low, high = min(float(band.w[0]) for band in bands), max(float(band.w[-1]) for band in bands)
    centre, half = (low + high) / 2.0, (high - low) / 2.0
    a = _denominator(bands, order, centre, half)
    if a is None:
        return None
    w = centre + half * chebyshev.chebroots(a)
    poles = 1j * w
    # Noise can throw the pole of a weak mode over the axis; its mirror image has the same modulus on it.
    return np.asarray(-np.abs(poles.real) + 1j * poles.imag)


def _columns(band: _DrivenBand, poles: ComplexArray, centre: float, half: float) -> tuple[ComplexArray, ComplexArray]:
    """Columns of residues and smooth parts (K, P*D + 3*D), and of start and end (K, 2*(P + 3))."""
    resonances = 1.0 / (1j * band.w[:, None] - poles)
    smooth = chebyshev.chebvander((band.w - centre) / half, _SMOOTH - 1)
    ours = (resonances[:, :, None] * band.U[:, None, :]).reshape(band.w.size, -1)
    rest = (smooth[:, :, None] * band.U[:, None, :]).reshape(band.w.size, -1)
    free = np.concatenate([resonances, smooth], axis=1)
    late = np.exp(-1j * band.w * band.duration_s)[:, None]
    return np.concatenate([ours, rest], axis=1), np.concatenate([free, free * late], axis=1)


@dataclass(frozen=True, eq=False)
class _Linear:
    """Least squares for given poles: solution (columns, S), spread of its columns, variance of what is left (S,)."""

    solution: ComplexArray
    spread: ComplexArray
    variance: FloatArray
    relative_error: float
    common: int
    own: int


def _linear(bands: list[_DrivenBand], poles: ComplexArray) -> _Linear:
    low, high = min(float(band.w[0]) for band in bands), max(float(band.w[-1]) for band in bands)
    parts = [_columns(band, poles, (low + high) / 2.0, (high - low) / 2.0) for band in bands]
    rows = np.cumsum([0, *[band.w.size for band in bands]])
    common, own = parts[0][0].shape[1], parts[0][1].shape[1]
    matrix = np.zeros((rows[-1], common + own * len(bands)), dtype=np.complex128)
    for r, (ours, free) in enumerate(parts):
        at = slice(rows[r], rows[r + 1])
        matrix[at, :common] = ours
        matrix[at, common + r * own : common + (r + 1) * own] = free
    scale = np.sqrt(np.mean(np.abs(matrix) ** 2, axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    Y = np.concatenate([band.Y for band in bands])
    u, s, vh = np.linalg.svd(matrix / scale, full_matrices=False)
    good = s > 1e-10 * s[0]
    inverse = (vh[good].conj().T / s[good]) / scale[:, None]
    solution = inverse @ (u[:, good].conj().T @ Y)
    residual = Y - matrix @ solution
    power = np.sum(np.abs(residual) ** 2, axis=0)
    return _Linear(
        solution,
        inverse @ inverse.conj().T,
        # Zero-padded bins come in pairs: half of them are independent.
        2.0 * power / max(rows[-1] - 2 * matrix.shape[1], 1),
        float(np.sqrt(np.sum(power) / np.sum(np.abs(Y) ** 2))),
        common,
        own,
    )


def respond(records: list[Record], order: int) -> Response | None:
    """Poles and residues of ``order`` modes from the driven ``records``; ``None`` where the band cannot tell."""
    used = sorted(records, key=lambda r: -r.duration_s)[:_MAX_RECORDS]
    band = band_hz(used) if used else None
    if band is None or not _enough(used, band, order):
        return None
    whole = [_spectra(r, 1, band) for r in used]
    # Modes closer than a bin can be missed by one set of records and seen by another.
    groups = [whole, *([[one] for one in whole] if len(whole) > 1 else [])]
    candidates = [poles for group in groups if (poles := _poles(group, order)) is not None]
    sound = [poles for poles in candidates if np.all(np.isfinite(poles)) and np.all(poles.real < 0.0)]
    if not sound:
        return None
    # Half bins tell what rings at the start from what rings at the end.
    bands = [_spectra(r, 2, band) for r in used]
    fits = [_linear(bands, poles) for poles in sound]
    best = min(range(len(fits)), key=lambda k: fits[k].relative_error)
    poles, fit = sound[best], fits[best]
    senses, drives, count = bands[0].Y.shape[1], bands[0].U.shape[1], poles.size
    span = count * drives
    places = [[fit.common + r * fit.own + p for p in range(count)] for r in range(len(bands))]
    start_sd = np.sqrt(np.array([[np.real(fit.spread[k, k]) * fit.variance / 2.0 for k in at] for at in places]))
    rate = used[0].sample_rate_hz
    return Response(
        poles=poles,
        residues=fit.solution[:span].reshape(count, drives, senses).transpose(0, 2, 1),
        covariance=fit.variance[:, None, None] * fit.spread[None, :span, :span],
        start_v=fit.solution[np.array(places)] * (2.0 / rate),
        start_sd_v=start_sd * (2.0 / rate),
        relative_error=fit.relative_error,
        records=tuple(r.name for r in used),
    )


def _enough(records: list[Record], band: tuple[float, float], order: int) -> bool:
    """More bins than unknowns, in every record."""
    unknowns = (order + 2) * (records[0].drive_v.shape[1] + len(records)) + order
    bins = [(band[1] - band[0]) * min(r.duration_s, _MAX_SAMPLES / r.sample_rate_hz) for r in records]
    return min(bins) > 4 * (order + 4) and sum(bins) > 2 * unknowns
