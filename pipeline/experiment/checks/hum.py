"""Mains hum: lines at the multiples of 50 or 60 Hz.

    a_h = 2 |sum w y exp(-j 2 pi h f t)| / sum w        local level: rms of the same at h f +- (4 .. 18)/T

w is a Hann window over the record of duration T.  Shapes: N samples, S senses, H harmonics, F frequencies.  Units: Hz, V.
"""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ..record import Campaign, Record
from .drives import is_driven
from .finding import Finding

MAINS_HZ = (50.0, 60.0)
_HARMONICS = 10
#: A line is significant above this many local levels: false-alarm probability below 1e-5 for the 80 lines tested.
_THRESHOLD = 5.0
#: Offsets of the neighbours from a line [1/T]: about 20 independent frequencies, outside the window's main lobe.
_NEIGHBOURS = np.concatenate([np.arange(-18, -3), np.arange(4, 19)])
_MIN_DURATION_S = 0.5


def _amplitudes(y: FloatArray, frequencies_hz: FloatArray, sample_rate_hz: float) -> FloatArray:
    """Amplitudes (F, S) [V] of y (N, S) at ``frequencies_hz`` (F,)."""
    window = np.hanning(y.shape[0])
    # One frequency at a time: the matrix of all exponentials would be large.
    t = np.arange(y.shape[0]) / sample_rate_hz
    sums = [np.abs((window * np.exp(-2j * np.pi * f * t)) @ y) for f in frequencies_hz]
    return np.array(sums) * (2.0 / window.sum())


def _local_level(y: FloatArray, frequency_hz: float, sample_rate_hz: float) -> FloatArray:
    """Rms (S,) [V] of the amplitudes of y (N, S) at the neighbours of ``frequency_hz``.

    They are multiples of 1/T away: bins of the Fourier transform of y turned back by ``frequency_hz``.
    """
    window = np.hanning(y.shape[0])
    turned = window * np.exp(-2j * np.pi * frequency_hz * (np.arange(y.shape[0]) / sample_rate_hz))
    around = np.abs(np.fft.fft(turned[:, None] * y, axis=0)[_NEIGHBOURS]) * (2.0 / window.sum())
    return np.asarray(np.sqrt(np.mean(around**2, axis=0)))


def _lines(record: Record, mains_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies (H,) [Hz], amplitudes and local levels (H, S) [V] of the harmonics at which no drive acts."""
    y = record.sense_v - record.sense_v.mean(axis=0)
    rate, duration = record.sample_rate_hz, record.duration_s
    harmonics: FloatArray = mains_hz * np.arange(1.0, _HARMONICS + 1.0)
    harmonics = harmonics[harmonics + 20.0 / duration < rate / 2.0]
    if harmonics.size and is_driven(record):
        drive = np.max(_amplitudes(record.drive_v - record.drive_v.mean(axis=0), harmonics, rate), axis=1)
        harmonics = harmonics[drive < 1e-4 * np.max(np.abs(record.drive_v))]
    line = _amplitudes(y, harmonics, rate).reshape(-1, y.shape[1])
    return harmonics, line, np.array([_local_level(y, f, rate) for f in harmonics]).reshape(line.shape)


def hum(campaign: Campaign) -> list[Finding]:
    """Mains lines in the longest silent record; without one, in the longest record, where no drive acts."""
    silent = [record for record in campaign.records if not is_driven(record)]
    record = max(silent or campaign.records, key=lambda r: r.duration_s)
    if record.duration_s < _MIN_DURATION_S:
        return []
    found = {mains: _lines(record, mains) for mains in MAINS_HZ}
    # Multiples of 300 Hz belong to both mains frequencies; the one with more significant lines gets them.
    counts = {m: int(np.sum(np.any(a > _THRESHOLD * local, axis=1))) for m, (_, a, local) in found.items()}
    mains = max(counts, key=lambda m: (counts[m], float(np.sum(found[m][1] ** 2))))
    frequencies, amplitude, local = found[mains]
    findings = []
    for k in range(record.sense_v.shape[1]):
        strong = np.flatnonzero(amplitude[:, k] > _THRESHOLD * local[:, k])
        if strong.size == 0:
            continue
        largest = strong[np.argmax(amplitude[strong, k])]
        lines = ", ".join(f"{amplitude[h, k] * 1e3:.3g} mV at {frequencies[h]:g} Hz" for h in strong)
        above = amplitude[largest, k] / local[largest, k]
        findings.append(
            Finding(
                "hum",
                "warning",
                f"sense{k + 1} shows {mains:g} Hz mains hum: {lines} (the strongest line is {above:.3g} times its"
                " surroundings). Improve grounding and shielding, or add the effect mains_hum to the model (gyroscreen"
                " model add mains_hum MODEL.toml).",
                record.name,
                f"sense{k + 1}",
                float(amplitude[largest, k]),
                float(local[largest, k]) / np.sqrt(2.0),
                "V",
            )
        )
    return findings
