"""Start values of a fit to frequency-domain records: poles and residues by least squares with the residues projected out.

    Y / |U| ~ sum_m (w / w_m) w_m c_m / (w_m^2 - w^2 + 2 i zeta_m w_m w) + B0      (linear in c, B0)

The factor w / w_m is that of a velocity; a displacement has none.  c is complex: R1 and R0 of a mode cannot be told apart near
its resonance.

Modes are added one by one where the residual is largest, and all poles are then refined together (variable projection, Golub
and Pereyra 1973).  The result is a modal record, from which each plant takes its start values as from any other.

Shapes: N rows, M modes, S senses, D drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...errors import MeasurementError
from ...experiment.antialias import filter_response
from ...experiment.files.modal_record import ModalRecord
from ...experiment.tones import ToneCampaign, ToneRecord

#: Rows that a start uses at most: more do not move it.
_ROWS = 4000


@dataclass(frozen=True, eq=False)
class LinearModes:
    """Modes of a linear fit: a modal record, the phase [rad] of the detector, and the share of the response that is left."""

    record: ModalRecord
    phase: float
    left: float


def linear_modes_of(campaign: ToneCampaign, modes: int, displacement: bool) -> LinearModes:
    """``modes`` poles and their residues, from the rows to fit at the lowest level of each record.

    The phase is that for which the residues are real, those of a velocity R1 or of a ``displacement`` R0; it is 0 for
    frequency responses.

    Raises
    ------
    MeasurementError : too few rows.
    """
    records = campaign.with_role("fit")
    f, u, y = _rows(records)
    if f.size < 4 * modes + 4:
        raise MeasurementError(
            "too few rows for the modes of the plant", value=f.size, allowed=f"at least {4 * modes + 4} rows"
        )
    poles: list[float] = []
    for _ in range(modes):
        left = y if not poles else _left(np.array(poles), f, u, y, displacement)[0]
        poles += _peak(f, left)
        poles = _refined(np.array(poles), f, u, y, displacement).tolist()
    found = np.array(poles)
    left, coefficients = _left(found, f, u, y, displacement)
    senses, drives = y.shape[1], u.shape[1]
    order = np.argsort(found[::2])
    frequency, zeta = found[::2][order], np.exp(found[1::2][order])
    # c = i R1 + R0 / w at resonance, (M, S, D) [1/s]
    c = np.moveaxis(coefficients[: modes * drives].reshape(modes, drives, senses)[order], 1, 2)
    behind = filter_response(campaign.instrument.antialias, 2.0j * np.pi * frequency)[:, None, None]
    real = c / behind * (1.0 if displacement else -1.0j)
    swept = any(one.kind == "sweep" for one in records)
    phase = 0.5 * float(np.angle(np.sum(real**2))) if swept else 0.0
    c = c * np.exp(-1.0j * phase)
    record = ModalRecord(
        campaign.device_id,
        frequency,
        zeta,
        R1=c.imag,
        R0=c.real * (2.0 * np.pi * frequency)[:, None, None],
        antialias=campaign.instrument.antialias,
        angular_gain=campaign.angular_gain,
    )
    return LinearModes(record, phase, float(np.linalg.norm(left)) / max(float(np.linalg.norm(y)), 1e-300))


def _rows(records: Sequence[ToneRecord]) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Frequencies (N,), drives (N, D) and senses (N, S), both over the level of the drive; the lowest level where it varies."""
    f, u, y = [], [], []
    for record in records:
        level = record.level_v
        kept = level <= 1.001 * level.min() if record.kind == "sweep" else np.ones(level.size, dtype=bool)
        step = max(1, int(kept.sum()) // _ROWS)
        rows = np.flatnonzero(kept)[::step]
        f.append(record.frequency_hz[rows])
        u.append(record.drive_v[rows] / level[rows, None])
        y.append(record.sense_v[rows] / level[rows, None])
    return np.concatenate(f), np.concatenate(u), np.concatenate(y)


def _columns(poles: FloatArray, f: FloatArray, u: ComplexArray, displacement: bool) -> ComplexArray:
    """(N, M D + D) columns of the residues, mode by mode, and of the background of each drive."""
    out = []
    for own, log_zeta in zip(poles[::2, None], poles[1::2]):
        over = 1.0 / (own**2 - f**2 + 2.0j * np.exp(log_zeta) * own * f) / (2.0 * np.pi)
        out.append((own if displacement else f)[..., None] * u * over[:, None])
    return np.concatenate([*out, u], axis=1)


def _left(
    poles: FloatArray, f: FloatArray, u: ComplexArray, y: ComplexArray, displacement: bool
) -> tuple[ComplexArray, ComplexArray]:
    """Residual (N, S), and the coefficients of the columns (K, S)."""
    columns = _columns(poles, f, u, displacement)
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    found, *_ = np.linalg.lstsq(columns / size, y, rcond=1e-9)
    return np.asarray(y - (columns / size) @ found), np.asarray(found / size[:, None])


def _peak(f: FloatArray, left: ComplexArray) -> list[float]:
    """(f, ln zeta) of the highest peak of the residual, its width between the points at 0.7 of it."""
    size = np.linalg.norm(left, axis=1)
    order = np.argsort(f)
    f, size = f[order], size[order]
    top = int(np.argmax(size))
    high = size > 0.7 * size[top]
    first, last = top, top
    while first > 0 and high[first - 1]:
        first -= 1
    while last < f.size - 1 and high[last + 1]:
        last += 1
    steps = np.diff(np.unique(f))
    width = max(float(f[last] - f[first]), float(np.median(steps)) if steps.size else 1e-3 * float(f[top]))
    return [float(f[top]), float(np.log(min(max(width / (2.0 * f[top]), 1e-8), 0.5)))]


def _refined(poles: FloatArray, f: FloatArray, u: ComplexArray, y: ComplexArray, displacement: bool) -> FloatArray:
    from scipy.optimize import least_squares

    span = float(np.ptp(f))
    norm = np.linalg.norm(y)
    low = np.tile([max(f.min() - 0.5 * span, 1e-3 * f.min()), np.log(1e-9)], poles.size // 2)
    high = np.tile([f.max() + 0.5 * span, np.log(0.9)], poles.size // 2)
    scale = np.stack([np.exp(poles[1::2]) * poles[::2], np.ones(poles.size // 2)], axis=1).reshape(-1)

    def rows(x: FloatArray) -> FloatArray:
        left = _left(x, f, u, y, displacement)[0] / norm
        return np.concatenate([left.real.reshape(-1), left.imag.reshape(-1)])

    found = least_squares(rows, np.clip(poles, low, high), bounds=(low, high), x_scale=scale, max_nfev=60)
    return np.asarray(found.x, dtype=np.float64)
