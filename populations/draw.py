"""Draw virtual devices of a population.

    device n --layout--> lot, wafer, die --irregularities--> changes --sum--> structure --assembly--> parameters

twice: as fabricated (stages fabrication and probe; pressure of the prober, nominal bias and temperature) and as packaged
(stages fabrication and package; lid pressure, operating bias and temperature).  Device n depends on (spec, seed, n) only.

Shapes: B devices.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class Draw:
    """B virtual devices.

    Parameters
    ----------
    index : device numbers n.
    device_id, lot, wafer, package : names, "D000123", "L01", "L01-W03", "P000123".
    die_x_mm, die_y_mm : centre of the die on its wafer (B,) [mm].
    fab : parameter of ``pipeline.quantities.MODEL`` -> (B,) [its unit], as the wafer prober measures it with its own
        channel gains.
    true : the same, as packaged, at the operating bias and temperature.
    effects : effect -> parameter -> (B,) [its unit], sizes of effects that are not parameters of the plant, as packaged.
    causes : contributions of each irregularity, (B,), as packaged: "split_hz.<irregularity>" [Hz] (projected on the anisotropy
        of the device, so that they add up to the split in first order), "frequency_hz.<irregularity>" [Hz] (mean rocking
        frequency) and "ln_quality.<irregularity>" [1] (ln of the mean rocking Q).
    numbers : the random numbers that the irregularities read.
    """

    index: IntArray
    device_id: tuple[str, ...]
    lot: tuple[str, ...]
    wafer: tuple[str, ...]
    package: tuple[str, ...]
    die_x_mm: FloatArray
    die_y_mm: FloatArray
    fab: dict[str, FloatArray]
    true: dict[str, FloatArray]
    effects: dict[str, dict[str, FloatArray]]
    causes: dict[str, FloatArray]
    numbers: DrawnNumbers


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
    changes: list[tuple[str, Stage, Change]] = []
    for irregularity, values in spec.found():
        site = Site(irregularity.name, recorded, index, placed, device, spec.wafer, operating)
        changes.append((irregularity.name, irregularity.stage, acted(irregularity, values, site)))

    springs = len(device.spring_azimuth_deg)

    def structure(*stages: Stage) -> Structure:
        return combine([(name, change) for name, stage, change in changes if stage in stages], count, springs)

    bias = operating.bias_v / device.nominal_bias_v
    packaged = structure("fabrication", "package")
    true = parameters(device, packaged, bias, operating.lid_pressure_pa / device.nominal_pressure_pa)
    probe = operating.probe_pressure_pa / device.nominal_pressure_pa
    fab = parameters(device, structure("fabrication", "probe"), 1.0, probe)

    causes: dict[str, FloatArray] = {}
    whole = stiffness(device, packaged, bias).rocking.anisotropy
    size = np.maximum(np.hypot(whole.real, whole.imag), np.finfo(np.float64).tiny)
    for name, stage, change in changes:
        if stage != "probe":
            alone = combine([(name, change)], count, springs)
            k = stiffness(device, alone, 1.0).rocking
            along = (k.anisotropy.real * whole.real + k.anisotropy.imag * whole.imag) / size
            loss, _ = inverse_quality(device, alone, 1.0)
            causes[f"split_hz.{name}"] = device.rocking_hz * along
            causes[f"frequency_hz.{name}"] = device.rocking_hz * (np.sqrt(k.mean) - 1.0)
            causes[f"ln_quality.{name}"] = np.log(1.0 / (loss * device.quality_rocking))

    lots = tuple(f"L{lot + 1:02d}" for lot in placed.lot.tolist())
    return Draw(
        index=index,
        device_id=tuple(f"D{n:06d}" for n in index.tolist()),
        lot=lots,
        wafer=tuple(f"{lot}-W{wafer + 1:02d}" for lot, wafer in zip(lots, placed.wafer_in_lot.tolist())),
        package=tuple(f"P{n:06d}" for n in index.tolist()),
        die_x_mm=placed.x_mm,
        die_y_mm=placed.y_mm,
        fab=fab,
        true=true,
        effects=effects(device, packaged, bias, true),
        causes=causes,
        numbers=recorded.drawn(count),
    )
