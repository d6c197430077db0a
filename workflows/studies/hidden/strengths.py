"""Strength of a hidden effect: its signal-to-noise ratio on the fitted records, without what the plant absorbs.

    snr = |(I - P) (y(effect) - y(none))| / sigma,    P projects onto d y / d (11 parameters of the plant) and the offsets

Shapes: N samples of a record, M samples of all fitted records and both channels.  Units: volts.
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

#: Relative tolerance of the SNR, and the largest number of simulations to reach it.
_TOLERANCE = 0.15
_TRIALS = 8


def row(records: Sequence[FloatArray]) -> FloatArray:
    """All records (N, 2), without the mean of each channel, concatenated (M,)."""
    return np.concatenate([(y - y.mean(axis=0)).ravel() for y in records])


@dataclass(frozen=True, eq=False)
class FittedBaseline:
    """Changes that the parameters of the plant can make: an orthonormal basis (M, 11) of them, and sigma [V]."""

    basis: FloatArray
    sigma_v: float

    def snr(self, change: Sequence[FloatArray]) -> float:
        """|(I - P) change| / sigma of a ``change`` (N, 2) [V] of every fitted record."""
        whole = row(change)
        rest = whole - self.basis @ (self.basis.T @ whole)
        return float(np.linalg.norm(rest)) / self.sigma_v


def baseline(
    values: Mapping[str, float],
    records: Sequence[Record],
    instrument: Instrument,
    sigma_v: float,
    records_differ: bool = False,
) -> FittedBaseline:
    """The baseline at plant ``values`` by name, with noise ``sigma_v`` [V].

    Of the fitted ``records`` only the drive samples (N, 2) [V] are used.  With ``records_differ`` the basis also holds a
    frequency shift, a time shift, gains and a ramp of every record.
    """
    model = DEFAULT_COMPARE_MODEL
    plant = {name: values[name] for name in PHYSICAL if name in model.by_name}
    columns = [jacobian(model, plant, record, instrument) for record in records]
    rows = np.stack([row([block[:, :, i] for block in columns]) for i in range(columns[0].shape[2])], axis=1)
    if records_differ:
        rows = np.concatenate([rows, _of_records(model.complete(plant), records, instrument)], axis=1)
    basis, _ = np.linalg.qr(rows / np.linalg.norm(rows, axis=0))
    return FittedBaseline(basis, sigma_v)


def _of_records(values: Mapping[str, float], records: Sequence[Record], instrument: Instrument) -> FloatArray:
    """Changes (M, 7 R) of single records: frequency, start, gain and ramp of both channels."""

    def at(scale: float) -> list[FloatArray]:
        return modelled(
            {**values, **{f"f{i}_hz": values[f"f{i}_hz"] * scale for i in (1, 2, 3)}}, (), records, instrument
        )

    here, above, below = at(1.0), at(1.0 + 1e-6), at(1.0 - 1e-6)
    columns = []
    for k, y in enumerate(here):
        ramp = np.linspace(-1.0, 1.0, y.shape[0])[:, None]
        own = [above[k] - below[k], np.gradient(y, axis=0)]
        own += [shape * np.eye(2)[s] for s in range(2) for shape in (y, np.broadcast_to(ramp, y.shape))]
        for shape in own:
            columns.append(row([shape if i == k else np.zeros_like(z) for i, z in enumerate(here)]))
    return np.stack(columns, axis=1)


def modelled(
    values: Mapping[str, float], effects: Sequence[str], records: Sequence[Record], instrument: Instrument
) -> list[FloatArray]:
    """The records (N, 2) [V] as the model under test predicts them; fast, and accurate enough to choose a size.

    Raises
    ------
    ConfigError : the values describe no device, or the motion diverges.
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
    """Size [1] of an effect (its parameters are ``size`` times their direction) and its SNR [sigma]."""

    size: float
    snr: float


def sized(snr_of: Callable[[float], float], target: float, most: float, start: float = 1.0) -> Sized:
    """The size whose SNR is ``target`` within 15 %, by the secant method in logarithms.

    Parameters
    ----------
    snr_of : SNR at a size; may raise ConfigError where the motion diverges.
    target : the SNR to reach [sigma].
    most : largest size; it is used even if its SNR is below the target.
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
        if abs(found.snr / target - 1.0) <= _TOLERANCE or (size == most and found.snr < target):
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
    """The next size, with SNR as a power of size; the power is 1 until two points are known."""
    if not np.isfinite(found.snr):
        return 0.03 * found.size
    if found.snr == 0.0:
        return 10.0 * found.size
    power = 1.0
    if previous is not None and previous.size != found.size and previous.snr > 0.0:
        power = float(np.clip(np.log(found.snr / previous.snr) / np.log(found.size / previous.size), 0.5, 4.0))
    return found.size * float(np.clip((target / found.snr) ** (1.0 / power), 1e-3, 1e3))
