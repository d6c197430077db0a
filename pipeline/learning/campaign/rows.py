"""The rows of a record: its whitened Fourier coefficients, their noise strata, and what its drive is called.

A record of N samples becomes, channel by channel, the coefficients sqrt(2/N) (Re, Im) Y(w)/sigma of the bins above zero up to
``TOP_HZ``: a unitary picture of that part of the data.
Shapes: N samples, S senses, F bins; rows 2 F, columns S.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray, IntArray
from ...experiment.record import Campaign, Record

#: Above this every effect of the library is as good as silent for drives below 700 Hz.
TOP_HZ = 2500.0
#: Lower edges of the bands in which the noise has one level.
_STRATA_HZ = (0.0, 350.0, 750.0, 1500.0)


@dataclass(frozen=True, eq=False)
class FourierRows:
    """Which bins of a record count, and how they are scaled."""

    samples: int
    bins: IntArray
    frequency_hz: FloatArray

    def __call__(self, y: FloatArray) -> FloatArray:
        """(.., N, S) -> (.., 2 F, S): unitary real Fourier coefficients."""
        # Along the last, contiguous axis a transform is several times faster than down a column.
        lines = np.ascontiguousarray(np.moveaxis(y, -2, -1))
        out = np.zeros((*lines.shape[:-2], 2 * self.bins.size, lines.shape[-2]))
        first, last = int(self.bins[0]), int(self.bins[-1]) + 1
        for place in np.ndindex(lines.shape[:-1]):
            if not lines[place].any():
                continue
            c = rfft(lines[place])[first:last] * np.sqrt(2.0 / self.samples)
            out[(*place[:-1], slice(None, self.bins.size), place[-1])] = c.real
            out[(*place[:-1], slice(self.bins.size, None), place[-1])] = c.imag
        return out


def spectra_of(record: Record) -> FourierRows:
    """Bins above zero, up to ``TOP_HZ`` and below Nyquist."""
    n, rate = record.drive_v.shape[0], record.sample_rate_hz
    bins = np.arange(1, (n - 1) // 2 + 1)
    frequency = bins * rate / n
    kept = frequency <= TOP_HZ
    return FourierRows(n, bins[kept], frequency[kept])


def strata_of(spectra: FourierRows, senses: int) -> IntArray:
    """Noise stratum of each row: band of frequency and channel."""
    band = np.digitize(spectra.frequency_hz, _STRATA_HZ) - 1
    both = np.concatenate([band, band])
    return np.asarray((both[:, None] * senses + np.arange(senses)).reshape(-1))


def block_diagonal(parts: Sequence[FloatArray]) -> list[FloatArray]:
    """Columns of single records (n_b, k_b) as columns of all of them (n_b, sum k)."""
    edges = np.cumsum([0, *(part.shape[1] for part in parts)])
    out = []
    for part, first in zip(parts, edges):
        wide = np.zeros((part.shape[0], int(edges[-1])))
        wide[:, first : first + part.shape[1]] = part
        out.append(wide)
    return out


def same_drive(a: Record, b: Record) -> bool:
    return a.drive_v.shape == b.drive_v.shape and bool(np.array_equal(a.drive_v, b.drive_v))


def labels_of(record: Record, campaign: Campaign) -> Mapping[str, str]:
    """Level, direction and drives of a record, in words that group records."""
    peaks = np.max(np.abs(record.drive_v), axis=0)
    most = max(float(np.max(np.abs(r.drive_v))) for r in campaign.records) or 1.0
    on = [d for d in range(peaks.size) if peaks[d] > 0.01 * most]
    direction = "none"
    if on:
        v = record.drive_v[:, on[0]]
        signs = np.signbit(v)
        half = v.size // 2
        early, late = np.count_nonzero(np.diff(signs[:half])), np.count_nonzero(np.diff(signs[half:]))
        direction = "up" if late > 1.1 * early else ("down" if early > 1.1 * late else "flat")
        if on[0] == 1 and direction in ("up", "down"):
            direction = "down" if direction == "up" else "up"
    return {
        "level": f"{float(peaks.max()) / most:.2g}",
        "direction": direction,
        "drives": "+".join(str(d + 1) for d in on) or "none",
    }
