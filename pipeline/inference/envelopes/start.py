"""Start values of a fit to amplitudes of free decays: the slopes of the logarithm of the amplitude, and of the phase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import MeasurementError
from ...experiment.envelopes import EnvelopeRecord
from ...experiment.noise.envelopes import EnvelopeNoise

#: Amplitudes above this multiple of the noise are used.
_CLEAR = 5.0


def modes_of_decays(records: Sequence[EnvelopeRecord], noise: Sequence[EnvelopeNoise]) -> list[tuple[float, float]]:
    """(f [Hz], zeta) of the modes that the records show, from the slopes of amplitude and phase, by frequency."""
    found: list[tuple[float, float]] = []
    for record, own in zip(records, noise):
        loud = int(np.argmax(record.amplitude_v.max(axis=0)))
        a = record.amplitude_v[:, loud]
        clear = np.minimum.accumulate(a > _CLEAR * own.floor_v[loud])
        count = max(int(np.count_nonzero(clear)), 8)
        t, weight = record.time_s[:count], a[:count] / a[0]
        slope = float(np.polyfit(t, np.log(np.maximum(a[:count], 1e-300)), 1, w=weight)[0])
        f = record.about_hz
        if record.phase_rad is not None:
            f += float(np.polyfit(t, record.phase_rad[:count, loud], 1, w=weight)[0]) / (2.0 * np.pi)
        if slope >= 0.0:
            raise MeasurementError(
                f"{record.name}: the amplitude does not decay",
                value=f"{slope:+.3g} 1/s",
                allowed="an amplitude that falls",
                next_step="leave out the driven part with start, and check [columns]",
            )
        if all(abs(f - other) > 0.02 * f for other, _ in found):
            found.append((f, min(-slope / (2.0 * np.pi * f), 0.5)))
    return sorted(found)
