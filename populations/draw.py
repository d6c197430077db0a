"""Draw virtual devices of a population.

    device n --layout--> lot, wafer, die --irregularities--> changes --sum--> structure --assembly--> parameters

twice: as fabricated (stages fabrication and probe; pressure of the prober, nominal bias and temperature) and as packaged
(stages fabrication and package; lid pressure, operating bias and temperature).  Device n depends on (spec, seed, n) only.

Shapes: B devices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import UsageError

from .acting import acted
from .assembly import Structure, combine, effects, inverse_quality, parameters, stiffness
from .drawn import DrawnNumbers, RecordedNumbers
from .irregularity import Change, Stage
from .layout import Places, places
from .numbers import Numbers, SeededNumbers
from .site import Site
from .spec import PopulationSpec

_STAGES: tuple[Stage, ...] = get_args(Stage)
#: Stages whose changes a packaged device has.
_PACKAGED: tuple[Stage, ...] = ("fabrication", "package")


@dataclass(frozen=True, eq=False)
class Draw:
    """B virtual devices.

    Parameters
    ----------
    index : device numbers n.
    placed : their places; ``die_x_mm``, ``die_y_mm`` are the centres of the dies on their wafers (B,) [mm].
    fab : parameter of ``pipeline.quantities.MODEL`` -> (B,) [its unit], as the wafer prober measures it with its own
        channel gains.
    true : the same, as packaged, at the operating bias and temperature.
    effects : effect -> parameter -> (B,) [its unit], sizes of effects that are not parameters of the plant, as packaged.
    changes : what each irregularity does, with its name and stage.
    numbers : the random numbers that the irregularities read.
    spec : the population.
    """

    index: IntArray
    placed: Places
    fab: dict[str, FloatArray]
    true: dict[str, FloatArray]
    effects: dict[str, dict[str, FloatArray]]
    changes: tuple[tuple[str, Stage, Change], ...]
    numbers: DrawnNumbers
    spec: PopulationSpec

    # Names and contributions are made where they are asked for: an attribution draws a population 91 times, for its parameters
    # alone; with them it takes 3.5 times as long.

    @cached_property
    def device_id(self) -> tuple[str, ...]:
        """Names of the devices, "D000123"."""
        return tuple(f"D{n:06d}" for n in self.index.tolist())

    @cached_property
    def lot(self) -> tuple[str, ...]:
        """Names of their lots, "L01"."""
        return tuple(f"L{lot + 1:02d}" for lot in self.placed.lot.tolist())

    @cached_property
    def wafer(self) -> tuple[str, ...]:
        """Names of their wafers, "L01-W03"."""
        return tuple(f"{lot}-W{wafer + 1:02d}" for lot, wafer in zip(self.lot, self.placed.wafer_in_lot.tolist()))

    @cached_property
    def package(self) -> tuple[str, ...]:
        """Names of their packages, "P000123"."""
        return tuple(f"P{n:06d}" for n in self.index.tolist())

    @property
    def die_x_mm(self) -> FloatArray:
        """(B,) x of the centre of the die on its wafer [mm]."""
        return self.placed.x_mm

    @property
    def die_y_mm(self) -> FloatArray:
        """(B,) y of the centre of the die on its wafer [mm]."""
        return self.placed.y_mm

    @cached_property
    def causes(self) -> dict[str, FloatArray]:
        """Contributions of each irregularity, (B,), as packaged.

        "split_hz.<irregularity>" [Hz] (projected on the anisotropy of the device, so that they add up to the split in first
        order), "frequency_hz.<irregularity>" [Hz] (mean rocking frequency), "ln_quality.<irregularity>" [1] (ln of the mean
        rocking Q).
        """
        device, found = self.spec.device, dict[str, FloatArray]()
        count, springs = len(self.index), len(device.spring_azimuth_deg)
        packaged = _structure(self.changes, count, springs, *_PACKAGED)
        whole = stiffness(device, packaged, self.spec.bias_ratio).rocking.anisotropy
        size = np.maximum(np.hypot(whole.real, whole.imag), np.finfo(np.float64).tiny)
        for name, stage, change in self.changes:
            if stage != "probe":
                alone = combine([(name, change)], count, springs)
                k = stiffness(device, alone, 1.0).rocking
                along = (k.anisotropy.real * whole.real + k.anisotropy.imag * whole.imag) / size
                loss, _ = inverse_quality(device, alone, 1.0)
                found[f"split_hz.{name}"] = device.rocking_hz * along
                found[f"frequency_hz.{name}"] = device.rocking_hz * (np.sqrt(k.mean) - 1.0)
                found[f"ln_quality.{name}"] = np.log(1.0 / (loss * device.quality_rocking))
        return found


def draw(spec: PopulationSpec, seed: int, first: int, count: int) -> Draw:
    """Devices ``first`` .. ``first + count - 1`` of the population.

    Raises
    ------
    UsageError : a negative seed or first, or a count below 1.
    ConfigError : an irregularity gives invalid changes, or a device has no positive stiffness.
    """
    for name, value, least in (("seed", seed, 0), ("first", first, 0), ("count", count, 1)):
        if value < least:
            raise UsageError(f"{name} is too small", value=value, allowed=f"{least} or more", next_step=f"raise {name}")
    index = np.arange(first, first + count, dtype=np.int64)
    return draw_with(spec, index, places(spec.wafer, index), SeededNumbers(seed))


def draw_with(spec: PopulationSpec, index: IntArray, placed: Places, numbers: Numbers) -> Draw:
    """The devices ``index`` (B,) at the places ``placed``, with random numbers from ``numbers``.

    Raises
    ------
    ConfigError : as :func:`draw`.
    """
    device, operating, count = spec.device, spec.operating, len(index)
    recorded = RecordedNumbers(numbers)
    changes = _changes(spec, index, placed, recorded, _STAGES)
    springs, bias = len(device.spring_azimuth_deg), spec.bias_ratio
    packaged = _structure(changes, count, springs, *_PACKAGED)
    true = _true(spec, packaged)
    probe = operating.probe_pressure_pa / device.nominal_pressure_pa
    fab = parameters(device, _structure(changes, count, springs, "fabrication", "probe"), 1.0, probe)
    sizes = effects(device, packaged, bias, true)
    return Draw(index, placed, fab, true, sizes, tuple(changes), recorded.drawn(count), spec)


def true_with(spec: PopulationSpec, index: IntArray, placed: Places, numbers: Numbers) -> dict[str, FloatArray]:
    """``true`` of :func:`draw_with` alone, bit for bit, in less than half of its time.

    Raises
    ------
    ConfigError : a device has no positive stiffness as packaged, or an irregularity gives invalid changes.
    """
    changes = _changes(spec, index, placed, numbers, _PACKAGED)
    return _true(spec, _structure(changes, len(index), len(spec.device.spring_azimuth_deg), *_PACKAGED))


def _true(spec: PopulationSpec, packaged: Structure) -> dict[str, FloatArray]:
    pressure = spec.operating.lid_pressure_pa / spec.device.nominal_pressure_pa
    return parameters(spec.device, packaged, spec.bias_ratio, pressure)


def _changes(
    spec: PopulationSpec, index: IntArray, placed: Places, numbers: Numbers, stages: Sequence[Stage]
) -> list[tuple[str, Stage, Change]]:
    """What each irregularity of ``stages`` does, with its name and stage."""
    changes: list[tuple[str, Stage, Change]] = []
    for irregularity, values in spec.found():
        if irregularity.stage in stages:
            site = Site(irregularity.name, numbers, index, placed, spec.device, spec.wafer, spec.operating)
            changes.append((irregularity.name, irregularity.stage, acted(irregularity, values, site)))
    return changes


def _structure(changes: Sequence[tuple[str, Stage, Change]], count: int, springs: int, *stages: Stage) -> Structure:
    """The devices with the changes of some stages."""
    return combine([(name, change) for name, stage, change in changes if stage in stages], count, springs)
