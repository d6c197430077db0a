"""How strong a hidden effect is: its signal-to-noise ratio on the fitted records, less what the baseline absorbs.

    snr = |(I - P) (y(effect) - y(none))| / sigma,    P projects on d y / d (11 parameters of the plant) and the offsets

Shapes: M samples of all fitted records and both channels in a row.  Units: volts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.device.gyro import PHYSICAL
from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.errors import ConfigError
from pipeline.experiment.forward.drive_groups import drive_groups_of
from pipeline.experiment.forward.record import jacobian
from pipeline.experiment.forward.response import volts
from pipeline.experiment.forward.system import assemble
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Record

#: A strength is hit to this share, in at most this many simulations.
_CLOSE = 0.15
_TRIALS = 8


def row(records: Sequence[FloatArray]) -> FloatArray:
    """Records (N, 2), each less its mean a channel, in one row (M,)."""
    return np.concatenate([(y - y.mean(axis=0)).ravel() for y in records])


@dataclass(frozen=True, eq=False)
class FittedBaseline:
    """What the plant's own parameters can do: an orthonormal basis (M, 11) of its signatures, and sigma [V]."""

    basis: FloatArray
    sigma_v: float

    def snr(self, change: Sequence[FloatArray]) -> float:
        """SNR of the change (N, 2) of every fitted record."""
        seen = row(change)
        left = seen - self.basis @ (self.basis.T @ seen)
        return float(np.linalg.norm(left)) / self.sigma_v


def baseline(
    values: Mapping[str, float], records: Sequence[Record], instrument: Instrument, sigma_v: float
) -> FittedBaseline:
    """The baseline around ``values`` on the fitted ``records``, whose drive samples alone are used."""
    model = DEFAULT_COMPARE_MODEL
    plant = {name: values[name] for name in PHYSICAL if name in model.by_name}
    columns = [jacobian(model, plant, record, instrument) for record in records]
    rows = np.stack([row([block[:, :, i] for block in columns]) for i in range(columns[0].shape[2])], axis=1)
    basis, _ = np.linalg.qr(rows / np.linalg.norm(rows, axis=0))
    return FittedBaseline(basis, sigma_v)


def modelled(
    values: Mapping[str, float], effects: Sequence[str], records: Sequence[Record], instrument: Instrument
) -> list[FloatArray]:
    """The records (N, 2) [V] as the model under test has them: quick, and good enough to choose a size by.

    Raises
    ------
    ConfigError : no such device, or a motion that diverges.
    """
    model = DEFAULT_COMPARE_MODEL
    for effect in effects:
        model = model.with_effect(effect)
    known = model.complete({name: value for name, value in values.items() if name in model.by_name})
    out: list[FloatArray] = [np.zeros(0)] * len(records)
    for places, group in drive_groups_of(records, instrument, None):
        system = assemble(model, known, instrument, group.conditions)
        for place, y in zip(places, volts(system, group)):
            out[place] = y
    return out


@dataclass(frozen=True)
class Sized:
    """Size of an effect (its parameters are ``size`` times their direction) and the SNR that it has."""

    size: float
    snr: float


def sized(snr_of: Callable[[float], float], target: float, most: float, start: float = 1.0) -> Sized:
    """The size whose SNR is ``target`` within 15 %, by secants in logarithms.

    Parameters
    ----------
    snr_of : SNR at a size; it may raise ConfigError where the motion diverges.
    most : largest size; where it is too weak for the target it is taken all the same.
    start : first guess.

    Raises
    ------
    ConfigError : no size gives a finite SNR.
    """
    low: Sized | None = None
    high: float | None = None
    previous: Sized | None = None
    size, best = min(start, most), Sized(0.0, 0.0)
    for _ in range(_TRIALS):
        try:
            found = Sized(size, snr_of(size))
        except ConfigError:
            found = Sized(size, np.inf)
        if np.isfinite(found.snr) and abs(np.log(max(found.snr, 1e-300) / target)) < abs(
            np.log(max(best.snr, 1e-300) / target)
        ):
            best = found
        if abs(found.snr / target - 1.0) <= _CLOSE or (size == most and found.snr < target):
            break
        if found.snr < target:
            low = found if low is None or size > low.size else low
        else:
            high = size if high is None else min(high, size)
        size = min(_next(found, previous, target), most)
        if high is not None and size >= high:
            size = np.sqrt(high * low.size) if low is not None else 0.1 * high
        if low is not None and size <= low.size:
            size = low.size * 3.0 if high is None else np.sqrt(high * low.size)
        previous = found if np.isfinite(found.snr) else previous
        size = min(float(size), most)
    if best.size == 0.0:
        raise ConfigError("no size of the hidden effect gives a finite motion", value=target)
    return best


def _next(found: Sized, previous: Sized | None, target: float) -> float:
    """A better size: SNR goes as a power of size, 1 until two points tell."""
    if not np.isfinite(found.snr):
        return 0.03 * found.size
    if found.snr == 0.0:
        return 10.0 * found.size
    power = 1.0
    if previous is not None and previous.size != found.size and previous.snr > 0.0:
        power = float(np.clip(np.log(found.snr / previous.snr) / np.log(found.size / previous.size), 0.5, 4.0))
    return found.size * float(np.clip((target / found.snr) ** (1.0 / power), 1e-3, 1e3))
