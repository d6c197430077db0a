"""Free decays as amplitude against time: what a lock-in amplifier or a spectrum analyzer shows of one mode.

    s(t) = Re(a(t) e^{i phi(t)})         amplitude A = |a + noise|, optionally phase phi - w_r t or frequency phi'/2pi

    E A = s sqrt(2/n) Gamma(n + 1/2)/Gamma(n) 1F1(-1/2; n; -n a^2 / 2 s^2)         Rician for n = 1: noise adds to a power

s is the sd of the in-phase and of the quadrature part (the floor), n the number of powers that are averaged.  A filter of the
detector with time constant T and m poles divides the amplitude by |1 + (a'/a + i (phi' - w_r)) T|^m.

Shapes: N rows, S senses.  Units: volts (peak), seconds, hertz, rad.
Source of the mean: Rice, Bell Syst. Tech. J. 24 (1945) 46, section 3.10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import FloatArray
from .record import Role

#: a / s above which the mean is sqrt(a^2 + (2 - 1/n) s^2) within 1e-5.
_LARGE = 12.0


@dataclass(frozen=True, eq=False)
class EnvelopeRecord:
    """Amplitude of one mode against time.

    Parameters
    ----------
    name : file name, or the name that a simulation gives.
    time_s : (N,) of each row [s], rising.
    amplitude_v : (N, S) peak amplitude of each sense [V].
    phase_rad : (N, S) phase relative to the reference [rad], continuous; ``None`` where none was recorded.
    frequency_hz : (N,) frequency [Hz]; ``None`` where none was recorded.
    tuned_hz : frequency [Hz] of the reference, or the centre of the analyzer; ``None`` where a frequency was recorded instead.
    sd_v : (N, S) declared sd of the amplitude [V]; ``None`` where none is declared.
    time_constant_s, poles : of the filter of the detector; 0: not known, taken as fast.
    averages : powers averaged in a row.
    role : "fit" or "validate"; ``None`` holds out every third stretch of the decay.
    rate_dps, bias_v : declared conditions, as of a time record.
    file : of its [[record]] in campaign.toml.
    units : "sense<k>_V" -> SI unit where that is not volts.
    """

    name: str
    time_s: FloatArray
    amplitude_v: FloatArray
    phase_rad: FloatArray | None = None
    frequency_hz: FloatArray | None = None
    tuned_hz: float | None = None
    sd_v: FloatArray | None = None
    time_constant_s: float = 0.0
    poles: int = 1
    averages: int = 1
    role: Role | None = None
    rate_dps: float | None = None
    bias_v: float | None = None
    file: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def shows_frequency(self) -> bool:
        """Whether rows tell the frequency, not the decay alone."""
        return self.phase_rad is not None or self.frequency_hz is not None

    @property
    def about_hz(self) -> float:
        """About where the mode lies [Hz]."""
        if self.frequency_hz is not None:
            # The noise of a frequency grows as the amplitude falls.
            return float(np.average(self.frequency_hz, weights=self.amplitude_v[:, 0] ** 2))
        assert self.tuned_hz is not None
        return self.tuned_hz


def mean_amplitude(a: FloatArray, s: float, averages: int = 1) -> FloatArray:
    """E A [V] (..,) of a true amplitude a (..,) [V] with the floor s [V], see the head of this module."""
    if s <= 0.0:
        return np.abs(a)
    # scipy.special is loaded where it is used.
    from scipy.special import gammaln, hyp1f1

    n = float(averages)
    out = np.sqrt(a**2 + (2.0 - 1.0 / n) * s**2)
    low = np.abs(a) < _LARGE * s
    factor = s * np.sqrt(2.0 / n) * np.exp(gammaln(n + 0.5) - gammaln(n))
    out[low] = factor * hyp1f1(-0.5, n, -n * a[low] ** 2 / (2.0 * s**2))
    return np.asarray(out)


def amplitude_sd(a: FloatArray, s: float, averages: int = 1) -> FloatArray:
    """sd of A [V] (..,) from noise of sd s [V]: sqrt(a^2 + 2 s^2 - (E A)^2); s / sqrt(n) far above the floor."""
    if s <= 0.0:
        return np.zeros_like(a)
    variance = a**2 + 2.0 * s**2 - mean_amplitude(a, s, averages) ** 2
    return np.sqrt(np.where(np.abs(a) < _LARGE * s, np.maximum(variance, 0.0), s**2 / averages))


def settled_rows(record: EnvelopeRecord) -> EnvelopeRecord:
    """The rows behind the transient of the filter, as far apart as their noise is independent: 3 T sqrt(m)."""
    wait = 3.0 * record.time_constant_s * np.sqrt(record.poles)
    if wait <= 0.0:
        return record
    kept, last = [], record.time_s[0] + (2.0 * record.poles + 1.0) * record.time_constant_s - wait
    for k, t in enumerate(record.time_s.tolist()):
        if t - last >= wait * (1.0 - 1e-9):
            kept.append(k)
            last = t
    return rows_of(record, np.array(kept, dtype=np.int64))


def rows_of(record: EnvelopeRecord, rows: np.ndarray | slice) -> EnvelopeRecord:
    """The record with some of its rows."""

    def cut(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else values[rows]

    return replace(
        record,
        time_s=record.time_s[rows],
        amplitude_v=record.amplitude_v[rows],
        phase_rad=cut(record.phase_rad),
        frequency_hz=cut(record.frequency_hz),
        sd_v=cut(record.sd_v),
    )
