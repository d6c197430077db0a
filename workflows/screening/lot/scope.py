"""The devices of a run and of its lots: order of examination, weights, and statistics of their fitted effect sizes.

A scope is the whole run or one lot.  Devices are examined in the order of the hashes of their ids, so that a sample depends
neither on where the devices were made nor on their results.

Shapes: n examined devices of a scope.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.criticism.shared import still_needed
from pipeline.device.gyro import PHYSICAL
from pipeline.device.model import Model
from reports.devices import ColumnSource, Devices
from reports.run.lot_effects import ParameterSize

from .device import DeviceExamination

#: A fitted size is significant if it is this many sd from its null value.
SIGNIFICANT_SD = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class LotDevice:
    """The part of a row of the devices table from which an examination starts; ``starts`` has the parameters of all rows."""

    number: int
    device_id: str
    lot: str
    flagged: bool
    starts: FloatArray

    @property
    def start(self) -> tuple[tuple[str, float], ...]:
        """(parameter, value) of this device."""
        return tuple(zip(PHYSICAL, self.starts[self.number].tolist()))


@dataclass(frozen=True)
class Scope:
    """The whole run ("") or one lot: devices with status misfit (flagged) and ok, in the order of examination."""

    lot: str
    flagged: tuple[LotDevice, ...]
    ok: tuple[LotDevice, ...]

    @property
    def population(self) -> int:
        """Number of devices that could be fitted."""
        return len(self.flagged) + len(self.ok)

    def weights(self, examined: Mapping[int, DeviceExamination]) -> dict[int, float]:
        """Number of devices that each examined device represents, by device number."""
        out: dict[int, float] = {}
        for group in (self.flagged, self.ok):
            numbers = [device.number for device in group if device.number in examined]
            out |= {number: len(group) / len(numbers) for number in numbers}
        return out


def devices_of(table: ColumnSource) -> tuple[LotDevice, ...]:
    """The devices from which a fit can start, in the order of examination."""
    devices = Devices(table)
    starts = np.stack([devices.number(name) for name in PHYSICAL], axis=1)
    known: BoolArray = np.asarray(np.isfinite(starts).all(axis=1))
    out = []
    for number, (name, lot, status) in enumerate(zip(*(devices.text(n) for n in ("device_id", "lot", "status")))):
        if status in ("ok", "misfit", "not_converged") and known[number]:
            out.append(LotDevice(number, name, lot, status == "misfit", starts))
    return tuple(sorted(out, key=lambda device: sha256(device.device_id.encode()).digest()))


def scopes_of(devices: Sequence[LotDevice]) -> tuple[Scope, ...]:
    """The whole run, followed by each lot if there are several."""

    def scope(lot: str, own: Sequence[LotDevice]) -> Scope:
        return Scope(lot, tuple(d for d in own if d.flagged), tuple(d for d in own if not d.flagged))

    lots = sorted({device.lot for device in devices})
    single = [scope(lot, [d for d in devices if d.lot == lot]) for lot in lots] if len(lots) > 1 else []
    return (scope("", devices), *single)


def lots_alternating(devices: Sequence[LotDevice]) -> list[LotDevice]:
    """The devices in an order that alternates between the lots."""
    places: dict[str, int] = {}
    keyed = []
    for device in devices:
        places[device.lot] = places.get(device.lot, -1) + 1
        keyed.append((places[device.lot], device.lot, device))
    return [device for _, _, device in sorted(keyed, key=lambda item: item[:2])]


def parameters_of(name: str) -> tuple[tuple[str, str, float], ...]:
    """Full name, unit and null value of each parameter of an effect."""
    model = Model(effects=(name,))
    effect = model.effect(name)
    return tuple((effect.full_name(m), m.unit, m.null) for m in effect.members(model.built.shape))


def bounds_of(name: str) -> tuple[tuple[float, float], ...]:
    """(low, high) of each parameter of an effect, in its unit."""
    model = Model(effects=(name,))
    return tuple(model.bounds(full) for full, _, _ in parameters_of(name))


def sizes_in(
    scope: Scope, examined: Mapping[int, DeviceExamination], parameter: str, null: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fitted sizes less ``null``, their sd and weights, each (n,), of the devices with the parameter in their model."""
    weights = scope.weights({n: one for n, one in examined.items() if parameter in one.parameters})
    pairs = [examined[n].parameters[parameter] for n in sorted(weights)]
    values = np.array([value - null for value, _ in pairs])
    return values, np.array([sd for _, sd in pairs]), np.array([weights[n] for n in sorted(weights)])


def needed_in(scope: Scope, examined: Mapping[int, DeviceExamination], name: str, alpha: float) -> bool:
    """Whether the fitted sizes of effect ``name`` are together significant in the scope, at family-wise ``alpha``."""
    own = parameters_of(name)
    return any(
        still_needed(*sizes_in(scope, examined, full, null), scope.population, alpha / len(own))
        for full, _, null in own
    )


def lacks(lot: Scope, examined: Mapping[int, DeviceExamination], name: str, sizes: Sequence[ParameterSize]) -> bool:
    """Whether the mean size in a lot is not significant, and significantly below half the mean of affected devices."""
    for (full, _, null), size in zip(parameters_of(name), sizes):
        mean, sd = _mean(*sizes_in(lot, examined, full, null))
        if abs(mean) < SIGNIFICANT_SD * sd and abs(mean) + SIGNIFICANT_SD * sd < 0.5 * abs(size.mean or 0.0):
            return True
    return False


def _mean(values: FloatArray, sds: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Mean size, weighted by inverse variance, and its sd: from the sd or from the scatter, whichever is larger."""
    if values.size == 0 or not np.all(sds > 0.0):
        return 0.0, float("inf")
    w = weights / sds**2
    w = w / w.sum()
    mean = float(w @ values)
    scatter = float(np.sqrt(np.sum(w**2 * (values - mean) ** 2)))
    return mean, max(float(np.sqrt(np.sum((w * sds) ** 2))), scatter)
