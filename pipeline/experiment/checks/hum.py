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
#: Samples used of a long record, 26 s at 10 kHz: over longer times the mains frequency wanders by more than 1/T.
_MOST_SAMPLES = 2**18
_BLOCK = 512


def _amplitudes(y: FloatArray, frequencies_hz: FloatArray, sample_rate_hz: float) -> FloatArray:
    """Amplitudes (F, S) [V] of y (N, S) at ``frequencies_hz`` (F,).

    exp(-j w (a B + b)) = exp(-j w a B) exp(-j w b), so blocks of B samples share one matrix of exponentials (B, F).
    """
    samples, senses = y.shape
    window, w = np.hanning(samples), 2.0 * np.pi * frequencies_hz / sample_rate_hz
    blocks = -(-samples // _BLOCK)
    turned = np.exp(-1j * np.arange(_BLOCK)[:, None] * w)
    carried = np.exp(-1j * _BLOCK * np.arange(blocks)[:, None] * w)
    out = np.empty((frequencies_hz.size, senses))
    for k in range(senses):
        padded = np.zeros(blocks * _BLOCK)
        padded[:samples] = window * y[:, k]
        rows = padded.reshape(blocks, _BLOCK)
        out[:, k] = np.abs(np.sum(carried * (rows @ turned.real + 1j * (rows @ turned.imag)), axis=0))
    return out * (2.0 / window.sum())


def _local_levels(y: FloatArray, frequencies_hz: FloatArray, sample_rate_hz: float) -> FloatArray:
    """Rms (F, S) [V] of the amplitudes of y (N, S) at the neighbours of each frequency (F,)."""
    near = frequencies_hz[:, None] + _NEIGHBOURS * (sample_rate_hz / y.shape[0])
    around = _amplitudes(y, near.ravel(), sample_rate_hz).reshape(*near.shape, y.shape[1])
    return np.asarray(np.sqrt(np.mean(around**2, axis=1)))


def _lines(record: Record, mains_hz: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies (H,) [Hz], amplitudes and local levels (H, S) [V] of the harmonics at which no drive acts."""
    y, drive_v = record.sense_v[:_MOST_SAMPLES], record.drive_v[:_MOST_SAMPLES]
    y = y - y.mean(axis=0)
    rate = record.sample_rate_hz
    duration = y.shape[0] / rate
    harmonics: FloatArray = mains_hz * np.arange(1.0, _HARMONICS + 1.0)
    harmonics = harmonics[harmonics + 20.0 / duration < rate / 2.0]
    if harmonics.size and is_driven(record):
        drive = np.max(_amplitudes(drive_v - drive_v.mean(axis=0), harmonics, rate), axis=1)
        harmonics = harmonics[drive < 1e-4 * np.max(np.abs(drive_v))]
    line = _amplitudes(y, harmonics, rate).reshape(-1, y.shape[1])
    return harmonics, line, _local_levels(y, harmonics, rate).reshape(line.shape)


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
