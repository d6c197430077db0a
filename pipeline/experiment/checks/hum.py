"""Mains hum: lines at the multiples of 50 or 60 Hz.

a_h = 2 |sum w y exp(-j 2 pi h f t)| / sum w,    local level: rms of the same at h f +- (4 .. 18)/T
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..record import Campaign, Record
from .finding import Finding
from .levels import is_driven

MAINS_HZ = (50.0, 60.0)
_HARMONICS = 10
#: Some 80 lines are looked at in a campaign; this many local rms levels keep false alarms below 1e-5 for all
#: of them.
_THRESHOLD = 5.0
#: Wide enough for some 20 independent frequencies; the window spreads a line over 2.
_NEIGHBOURS = np.concatenate([np.arange(-18.0, -3.0), np.arange(4.0, 19.0)])
_MIN_DURATION_S = 0.5


def _amplitudes(y: FloatArray, frequencies_hz: FloatArray, sample_rate_hz: float) -> FloatArray:
    """a (F, S) [V] of y (N, S)."""
    window = np.hanning(y.shape[0])
    # A whole kernel matrix would be large; the lines are few.
    t = np.arange(y.shape[0]) / sample_rate_hz
    sums = [np.abs((window * np.exp(-2j * np.pi * f * t)) @ y) for f in frequencies_hz]
    return np.array(sums) * (2.0 / window.sum())


def _lines(record: Record, mains_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies (H,), amplitudes (H, S) and local levels (H, S) of the harmonics where the drive is quiet."""
    y = record.sense_v - record.sense_v.mean(axis=0)
    rate, duration = record.sample_rate_hz, record.duration_s
    harmonics: FloatArray = mains_hz * np.arange(1.0, _HARMONICS + 1.0)
    harmonics = harmonics[harmonics + 20.0 / duration < rate / 2.0]
    if harmonics.size and is_driven(record):
        drive = np.max(_amplitudes(record.drive_v - record.drive_v.mean(axis=0), harmonics, rate), axis=1)
        harmonics = harmonics[drive < 1e-4 * np.max(np.abs(record.drive_v))]
    line = _amplitudes(y, harmonics, rate).reshape(-1, y.shape[1])
    around = np.array([_amplitudes(y, f + _NEIGHBOURS / duration, rate) for f in harmonics])
    local: FloatArray = np.sqrt(np.mean(around**2, axis=1)) if harmonics.size else line
    return harmonics, line, local


def hum(campaign: Campaign) -> list[Finding]:
    """Lines of the mains in the longest silent record, or, without one, beside the drive in the longest
    record.
    """
    silent = [record for record in campaign.records if not is_driven(record)]
    record = max(silent or campaign.records, key=lambda r: r.duration_s)
    if record.duration_s < _MIN_DURATION_S:
        return []
    found = {mains: _lines(record, mains) for mains in MAINS_HZ}
    # Multiples of 300 Hz belong to both: the mains with more significant lines has them.
    counts = {m: int(np.sum(np.any(a > _THRESHOLD * local, axis=1))) for m, (_, a, local) in found.items()}
    mains = max(counts, key=lambda m: (counts[m], float(np.sum(found[m][1] ** 2))))
    frequencies, amplitude, local = found[mains]
    findings = []
    for k in range(record.sense_v.shape[1]):
        strong = np.flatnonzero(amplitude[:, k] > _THRESHOLD * local[:, k])
        if strong.size == 0:
            continue
        largest = strong[np.argmax(amplitude[strong, k])]
        lines = ", ".join(f"{frequencies[h]:g} Hz {amplitude[h, k] * 1e3:.3g} mV" for h in strong)
        findings.append(
            Finding(
                "hum",
                "warning",
                f"{mains:g} Hz mains hum in sense{k + 1}: {lines}; mend the wiring, or add the effect"
                " mains_hum to the model (gyroscreen model add mains_hum MODEL.toml)",
                record.name,
                f"sense{k + 1}",
                float(amplitude[largest, k]),
                float(local[largest, k]) / np.sqrt(2.0),
                "V",
            )
        )
    return findings
