"""The devices of a run and of its lots: which are examined, what they stand for, and what their refits say together.

A scope is the whole run or one lot.  Devices are examined in the order of their names' hashes, so that a sample has nothing to
do with where they were made or how they fared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256

import numpy as np
import pyarrow as pa

from pipeline.arrays import FloatArray
from pipeline.criticism.shared import still_needed
from pipeline.device.gyro import PHYSICAL
from pipeline.device.model import Model
from reports.run.lot_effects import ParameterSize

from .device import DeviceExamination

#: A size is seen where it is so many sd from null.
SEEN = 3.0


@dataclass(frozen=True)
class LotDevice:
    """A row of the devices table, as far as it is needed here."""

    number: int
    device_id: str
    lot: str
    flagged: bool
    start: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Scope:
    """The whole run ("") or one lot: its flagged and its ok devices, in the order in which they are examined."""

    lot: str
    flagged: tuple[LotDevice, ...]
    ok: tuple[LotDevice, ...]

    @property
    def population(self) -> int:
        """Devices that could be fitted."""
        return len(self.flagged) + len(self.ok)

    def weights(self, looks: Mapping[int, DeviceExamination]) -> dict[int, float]:
        """How many devices each examined one stands for."""
        out: dict[int, float] = {}
        for group in (self.flagged, self.ok):
            seen = [device.number for device in group if device.number in looks]
            out |= {number: len(group) / len(seen) for number in seen}
        return out


def devices_of(table: pa.Table) -> tuple[LotDevice, ...]:
    """The devices that a fit can start from, in the order in which they are examined."""
    columns = {name: table.column(name).to_pylist() for name in ("device_id", "lot", "status", *PHYSICAL)}
    out = []
    for number, (name, lot, status) in enumerate(zip(columns["device_id"], columns["lot"], columns["status"])):
        start = tuple((q, columns[q][number]) for q in PHYSICAL)
        if status in ("ok", "misfit", "not_converged") and all(value is not None for _, value in start):
            out.append(LotDevice(number, name, lot or "", status == "misfit", start))
    return tuple(sorted(out, key=lambda device: sha256(device.device_id.encode()).digest()))


def scopes_of(devices: Sequence[LotDevice]) -> tuple[Scope, ...]:
    """The whole run, then each lot where there are several."""

    def scope(lot: str, own: Sequence[LotDevice]) -> Scope:
        return Scope(lot, tuple(d for d in own if d.flagged), tuple(d for d in own if not d.flagged))

    lots = sorted({device.lot for device in devices})
    single = [scope(lot, [d for d in devices if d.lot == lot]) for lot in lots] if len(lots) > 1 else []
    return (scope("", devices), *single)


def in_turn(devices: Sequence[LotDevice]) -> list[LotDevice]:
    """Devices in an order that visits the lots in turn."""
    places: dict[str, int] = {}
    keyed = []
    for device in devices:
        places[device.lot] = places.get(device.lot, -1) + 1
        keyed.append((places[device.lot], device.lot, device))
    return [device for _, _, device in sorted(keyed, key=lambda item: item[:2])]


def parameters_of(name: str) -> tuple[tuple[str, str, float], ...]:
    """Full names, units and nulls of an effect's parameters."""
    model = Model(effects=(name,))
    effect = model.effect(name)
    return tuple((effect.full_name(m), m.unit, m.null) for m in effect.members(model.built.shape))


def bounds_of(name: str) -> tuple[tuple[float, float], ...]:
    model = Model(effects=(name,))
    return tuple(model.bounds(full) for full, _, _ in parameters_of(name))


def sizes_in(
    scope: Scope, looks: Mapping[int, DeviceExamination], parameter: str, null: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fitted sizes, their sds and weights of a scope's devices that have the parameter in their model."""
    weights = scope.weights({n: one for n, one in looks.items() if parameter in one.parameters})
    pairs = [looks[n].parameters[parameter] for n in sorted(weights)]
    values = np.array([value - null for value, _ in pairs])
    return values, np.array([sd for _, sd in pairs]), np.array([weights[n] for n in sorted(weights)])


def needed_in(scope: Scope, looks: Mapping[int, DeviceExamination], name: str, alpha: float) -> bool:
    own = parameters_of(name)
    return any(
        still_needed(*sizes_in(scope, looks, full, null), scope.population, alpha / len(own)) for full, _, null in own
    )


def lacks(lot: Scope, looks: Mapping[int, DeviceExamination], name: str, sizes: Sequence[ParameterSize]) -> bool:
    """Whether a lot's mean size is null within ``SEEN`` sd, and surely below half of what carriers have."""
    for (full, _, null), size in zip(parameters_of(name), sizes):
        mean, sd = _mean(*sizes_in(lot, looks, full, null))
        if abs(mean) < SEEN * sd and abs(mean) + SEEN * sd < 0.5 * abs(size.mean or 0.0):
            return True
    return False


def _mean(values: FloatArray, sds: FloatArray, weights: FloatArray) -> tuple[float, float]:
    """Mean size by inverse variance, and its sd, from the sds or from the scatter, whichever is larger."""
    if values.size == 0 or not np.all(sds > 0.0):
        return 0.0, float("inf")
    w = weights / sds**2
    w = w / w.sum()
    mean = float(w @ values)
    scatter = float(np.sqrt(np.sum(w**2 * (values - mean) ** 2)))
    return mean, max(float(np.sqrt(np.sum((w * sds) ** 2))), scatter)
