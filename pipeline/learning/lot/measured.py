"""A measured lot: quantities of devices, their covariance, and where each device was made.

Quantities are in the coordinates in which the model is linear: those with the transform "log" are natural logarithms, and a
pair of split and angle is a pair of anisotropy components (``gyro``).

Shapes: n devices, q quantities.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...errors import MeasurementError

#: Fewer devices than this leave no spread to be estimated beside the means.
LEAST_DEVICES = 4


@dataclass(frozen=True, eq=False)
class MeasuredLot:
    """Devices of one or more lots.

    Parameters
    ----------
    name : of the lot or of the table.
    quantities, units : q names and units of the columns of ``values``.
    values : (n, q) in those units; nan where a quantity was not measured.
    covariance : (n, q, q) of the measurement, unit by unit; zero where it is not known.
    labels : level ("lot", "wafer", "package", "tester") -> label of each device (n,); only the levels that are known.
        A wafer belongs to one lot, so its label stands beside that of the lot.
    x_mm, y_mm : (n,) centre of the die on the wafer [mm], nan where it is not known.
    radius_mm : of the wafer [mm], which scales the patterns.
    time : (n,) [any unit], nan where it is not known.
    device : n names.
    held : names "lot/wafer" of the wafers that no fit may see.
    """

    name: str
    quantities: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    labels: Mapping[str, tuple[str, ...]]
    x_mm: FloatArray
    y_mm: FloatArray
    radius_mm: float
    time: FloatArray
    device: tuple[str, ...]
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, q = self.values.shape
        if n < LEAST_DEVICES:
            raise MeasurementError(
                f"lot {self.name} has too few devices",
                value=n,
                allowed=f"at least {LEAST_DEVICES}",
                next_step="give a larger table, or a run with more devices",
            )
        if not np.any(np.isfinite(self.values)):
            raise MeasurementError(
                f"lot {self.name} has no finite value",
                value=", ".join(self.quantities),
                next_step="correct the columns in lot.toml",
            )
        assert self.covariance.shape == (n, q, q)

    @property
    def seen(self) -> BoolArray:
        """(n, q) where a value is finite."""
        return np.asarray(np.isfinite(self.values))

    def codes(self, level: str) -> IntArray:
        """(n,) number of the lot, wafer, package, tester or place of each device, from 0; 0 where the level is not known."""
        if level == "place":
            at = np.round(np.nan_to_num(self.x_mm), 3) + 1j * np.round(np.nan_to_num(self.y_mm), 3)
            return np.unique(at, return_inverse=True)[1].astype(np.int64)
        if level == "wafer":
            names = [f"{a}/{b}" for a, b in zip(self._label("lot"), self._label("wafer"))]
        else:
            names = list(self._label(level))
        return np.unique(np.array(names), return_inverse=True)[1].astype(np.int64)

    def _label(self, level: str) -> tuple[str, ...]:
        return self.labels.get(level, ("",) * len(self.device))

    @cached_property
    def wafers(self) -> tuple[str, ...]:
        """Name "lot/wafer" of each device."""
        return tuple(f"{a}/{b}" for a, b in zip(self._label("lot"), self._label("wafer")))

    @property
    def is_held(self) -> BoolArray:
        """(n,) whether the device lies on a wafer that is held out."""
        return np.isin(np.array(self.wafers), np.array(self.held, dtype=object).astype(str))

    @property
    def x(self) -> FloatArray:
        """(n,) position [wafer radius], 0 where it is not known."""
        return np.nan_to_num(self.x_mm / self.radius_mm)

    @property
    def y(self) -> FloatArray:
        """(n,) position [wafer radius], 0 where it is not known."""
        return np.nan_to_num(self.y_mm / self.radius_mm)

    @property
    def placed(self) -> bool:
        """Whether every die has a position."""
        return bool(np.all(np.isfinite(self.x_mm)) and np.all(np.isfinite(self.y_mm)))

    def subset(self, chosen: BoolArray) -> MeasuredLot:
        """The devices where ``chosen`` (n,)."""
        keep = np.flatnonzero(chosen).tolist()
        return replace(
            self,
            values=self.values[chosen],
            covariance=self.covariance[chosen],
            labels={level: tuple(names[k] for k in keep) for level, names in self.labels.items()},
            x_mm=self.x_mm[chosen],
            y_mm=self.y_mm[chosen],
            time=self.time[chosen],
            device=tuple(self.device[k] for k in keep),
        )


def hold_out(lot: MeasuredLot, share: float = 0.2) -> MeasuredLot:
    """The lot with whole lots held out where there are six or more, else whole wafers; none where there are fewer than four.

    The last units by name are held out, at least one and about ``share`` of them, spread over the lots: what is made last is
    what a forecast is for, and the choice does not depend on the values.
    """
    lots = np.array(lot._label("lot"))
    names = np.array(lot.wafers)
    if len(np.unique(lots)) >= 6:
        units = np.unique(lots)
        chosen = units[-max(1, round(share * len(units))) :]
        held = np.unique(names[np.isin(lots, chosen)])
    else:
        per_lot = [np.unique(names[lots == one]) for one in np.unique(lots)]
        total = sum(map(len, per_lot))
        wanted = max(1, round(share * total)) if total >= 4 else 0
        last_first = [list(wafers[:0:-1]) for wafers in per_lot]  # a lot keeps its first wafer
        held_names: list[str] = []
        while len(held_names) < wanted and any(last_first):
            for wafers in last_first:
                if wafers and len(held_names) < wanted:
                    held_names.append(str(wafers.pop(0)))
        held = np.array(sorted(held_names))
    return replace(lot, held=tuple(str(one) for one in held))
