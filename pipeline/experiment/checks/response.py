"""Poles and residues of the response in the driven band, without a model of the device.

    Y_i(w) = sum_j (sum_p r_pij / (j w - p) + smooth_ij(w)) U_j(w) + start_i(w) - end_i(w) exp(-j w T)
    start, end = sum_p c_p / (j w - p) + smooth(w)

This is exact for linear modes and records of any length T: the last two terms hold the free motion at the start and at the
end of the record.  A rational fit with a common denominator gives the poles (Sanathanan and Koerner, IEEE Trans. Automat.
Contr. 8 (1963) 56); for given poles the other unknowns are linear.

Shapes: P poles, S senses, D drives, R records, K bins.  Frequencies and poles in rad/s.  Residues [1/s] are those of the
samples: they contain hold, filter, delay and ADC.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.fft import rfft

from ...arrays import BoolArray, ComplexArray, FloatArray
from ..record import Record

_ITERATIONS = 10
#: Samples and bins of a record that are used.  A slow chirp over modes of a high Q does not pass them all in fewer samples; of
#: its bins the strongest half, where the modes are, and others at a constant distance carry what a fit needs.
_MAX_SAMPLES = 2**19
_MAX_BINS = 2**13
_MAX_RECORDS = 4
#: Bins with less than this share of the strongest drive power are left out.
_DRIVEN = 1e-3
#: Half the width of the band, relative to the centre frequency of the response.
_BAND = 0.3
#: Chebyshev terms of each smooth part.
_SMOOTH = 3


@dataclass(frozen=True, eq=False)
class Response:
    """Poles and residues of the driven band.

    Parameters
    ----------
    poles : (P,) [rad/s].
    residues : (P, S, D) [1/s].
    covariance : (S, P*D, P*D) of the residues of each sense.
    start_v, start_sd_v : (R, P, S) amplitudes of the free motion at the first sample, and their sd [V].
    relative_error : norm of the residual over norm of the spectra in the band.
    records : (R,) names of the records used.
    """

    poles: ComplexArray
    residues: ComplexArray
    covariance: ComplexArray
    start_v: ComplexArray
    start_sd_v: FloatArray
    relative_error: float
    records: tuple[str, ...]

    def summed(self, which: list[int]) -> tuple[ComplexArray, FloatArray]:
        """Sum (S, D) of the residues of the poles ``which``, and the sd (S, D) of its real or imaginary part [1/s]."""
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
    """Spectra of one record at the frequencies used: w (K,) [rad/s]; drive U (K, D) and sense Y (K, S), unscaled DFTs."""

    w: FloatArray
    U: ComplexArray
    Y: ComplexArray
    duration_s: float


def _smoothed(power: FloatArray, width: int) -> FloatArray:
    return np.convolve(power, np.ones(width) / width, mode="same")


def _spectra(record: Record, padded: int, band_hz: tuple[float, float], most: int | None = _MAX_BINS) -> _DrivenBand:
    count = min(record.drive_v.shape[0], _MAX_SAMPLES)
    drive = record.drive_v[:count]
    sense = record.sense_v[:count] - record.sense_v[:count].mean(axis=0)
    size = padded * count
    w = 2.0 * np.pi * np.arange(size // 2 + 1) * record.sample_rate_hz / size
    inside = np.flatnonzero((w >= 2.0 * np.pi * band_hz[0]) & (w <= 2.0 * np.pi * band_hz[1]))
    Y = rfft(sense, size, axis=0)[inside]
    kept = _informative(np.sum(np.abs(Y) ** 2, axis=1), most)
    U = rfft(drive, size, axis=0)[inside[kept]]
    return _DrivenBand(w[inside[kept]], U, Y[kept], count / record.sample_rate_hz)


def _informative(power: FloatArray, most: int | None) -> NDArray[np.int64]:
    """At most ``most`` of the bins with this ``power`` (K,): the strongest half, and others at a constant distance."""
    if most is None or power.size <= most:
        return np.arange(power.size)
    strongest = np.argpartition(power, -(most // 2))[-(most // 2) :]
    others = np.linspace(0, power.size - 1, most // 2).astype(np.int64)
    return np.unique(np.concatenate([strongest, others]))


def band_hz(records: list[Record]) -> tuple[float, float] | None:
    """Edges [Hz] of the driven band around the centre of the response; ``None`` where nothing is driven."""
    edges = []
    for record in records:
        full = _spectra(record, 1, (0.0, record.sample_rate_hz / 2.0), None)
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
    """Chebyshev coefficients (order + 1,) of A in A Y = B U + T, by iterated weighted least squares (Sanathanan-Koerner)."""
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
        projected = [part * weight[:, None] - q @ (q.conj().T @ (part * weight[:, None])) for part in powers]
        stacked = np.concatenate(projected)
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
    # Noise can make the pole of a weak mode unstable; its mirror image has the same modulus on the imaginary axis.
    return np.asarray(-np.abs(poles.real) + 1j * poles.imag)


def _columns(band: _DrivenBand, poles: ComplexArray, centre: float, half: float) -> tuple[ComplexArray, ComplexArray]:
    """Columns of the residues and smooth parts (K, P*D + 3*D), and of the start and end terms (K, 2*(P + 3))."""
    resonances = 1.0 / (1j * band.w[:, None] - poles)
    smooth = chebyshev.chebvander((band.w - centre) / half, _SMOOTH - 1)
    driven = (resonances[:, :, None] * band.U[:, None, :]).reshape(band.w.size, -1)
    background = (smooth[:, :, None] * band.U[:, None, :]).reshape(band.w.size, -1)
    start = np.concatenate([resonances, smooth], axis=1)
    at_end = np.exp(-1j * band.w * band.duration_s)[:, None]
    return np.concatenate([driven, background], axis=1), np.concatenate([start, start * at_end], axis=1)


@dataclass(frozen=True, eq=False)
class _LinearFit:
    """Least-squares solution for given poles.

    solution (columns, S); covariance (columns, columns) at unit noise variance; variance (S,) of the residual; ``common``
    columns are shared by all records, ``own`` belong to each record.
    """

    solution: ComplexArray
    covariance: ComplexArray
    variance: FloatArray
    relative_error: float
    common: int
    own: int


def _linear_fit(bands: list[_DrivenBand], poles: ComplexArray) -> _LinearFit:
    low, high = min(float(band.w[0]) for band in bands), max(float(band.w[-1]) for band in bands)
    parts = [_columns(band, poles, (low + high) / 2.0, (high - low) / 2.0) for band in bands]
    rows = np.cumsum([0, *[band.w.size for band in bands]])
    common, own = parts[0][0].shape[1], parts[0][1].shape[1]
    matrix = np.zeros((rows[-1], common + own * len(bands)), dtype=np.complex128)
    for r, (shared, ends) in enumerate(parts):
        at = slice(rows[r], rows[r + 1])
        matrix[at, :common] = shared
        matrix[at, common + r * own : common + (r + 1) * own] = ends
    scale = np.sqrt(np.mean(np.abs(matrix) ** 2, axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    Y = np.concatenate([band.Y for band in bands])
    u, s, vh = np.linalg.svd(matrix / scale, full_matrices=False)
    good = s > 1e-10 * s[0]
    inverse = (vh[good].conj().T / s[good]) / scale[:, None]
    solution = inverse @ (u[:, good].conj().T @ Y)
    residual = Y - matrix @ solution
    power = np.sum(np.abs(residual) ** 2, axis=0)
    return _LinearFit(
        solution,
        inverse @ inverse.conj().T,
        # With twofold zero padding only half of the bins are independent.
        2.0 * power / max(rows[-1] - 2 * matrix.shape[1], 1),
        float(np.sqrt(np.sum(power) / np.sum(np.abs(Y) ** 2))),
        common,
        own,
    )


def respond(records: list[Record], order: int) -> Response | None:
    """Poles and residues of ``order`` modes from driven ``records``.

    The longest records are used, at most ``_MAX_RECORDS``.  ``None`` where no record is driven, the bins are too few for the
    unknowns, or no stable poles are found.
    """
    used = sorted(records, key=lambda r: -r.duration_s)[:_MAX_RECORDS]
    band = band_hz(used) if used else None
    if band is None or not _enough(used, band, order):
        return None
    whole = [_spectra(r, 1, band) for r in used]
    # Two modes closer than a bin can be unresolved by all records together and resolved by one of them.
    groups = [whole, *([[one] for one in whole] if len(whole) > 1 else [])]
    candidates = [poles for group in groups if (poles := _poles(group, order)) is not None]
    stable = [poles for poles in candidates if np.all(np.isfinite(poles)) and np.all(poles.real < 0.0)]
    if not stable:
        return None
    # Bins at half the spacing separate free motion at the start from free motion at the end.
    bands = [_spectra(r, 2, band) for r in used]
    fits = [_linear_fit(bands, poles) for poles in stable]
    best = min(range(len(fits)), key=lambda k: fits[k].relative_error)
    poles, fit = stable[best], fits[best]
    senses, drives, count = bands[0].Y.shape[1], bands[0].U.shape[1], poles.size
    span = count * drives
    rows = [[fit.common + r * fit.own + p for p in range(count)] for r in range(len(bands))]
    start_sd = np.sqrt(np.array([[np.real(fit.covariance[k, k]) * fit.variance / 2.0 for k in at] for at in rows]))
    rate = used[0].sample_rate_hz
    return Response(
        poles=poles,
        residues=fit.solution[:span].reshape(count, drives, senses).transpose(0, 2, 1),
        covariance=fit.variance[:, None, None] * fit.covariance[None, :span, :span],
        start_v=fit.solution[np.array(rows)] * (2.0 / rate),
        start_sd_v=start_sd * (2.0 / rate),
        relative_error=fit.relative_error,
        records=tuple(r.name for r in used),
    )


def _enough(records: list[Record], band: tuple[float, float], order: int) -> bool:
    """Whether each record and all of them together have more bins than unknowns."""
    unknowns = (order + 2) * (records[0].drive_v.shape[1] + len(records)) + order
    bins = [(band[1] - band[0]) * min(r.duration_s, _MAX_SAMPLES / r.sample_rate_hz) for r in records]
    return min(bins) > 4 * (order + 4) and sum(bins) > 2 * unknowns
