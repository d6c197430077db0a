"""What an irregularity does to the devices of a few wafers, as the picture of its page shows it.

Of an irregularity of a population: the population is drawn twice with the same random numbers, with it and without it.  Of a
generic irregularity: one draw of its parts at the dies of four wafers.

Shapes: B devices, n devices of a lot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.learning.lot.generic import GenericIrregularity
from pipeline.learning.lot.gyro import COORDINATES
from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.model import RandomPart, merged
from pipeline.quantities import AXES, MODEL
from populations.draw import Draw, draw
from populations.irregularity import Irregularity
from populations.layout import die_centres
from populations.numbers import field_factor
from populations.spec import PopulationSpec

from ..lots.population import population_at, trial_spec

_SEED = 2
#: Shares below this are not drawn.
_LEAST_SHARE = 1e-3
_BARS = 8
_UNITS = {quantity.name: quantity.unit for quantity in MODEL}
_LOTS, _WAFERS = 2, 2


@dataclass(frozen=True, eq=False)
class WaferPicture:
    """Values at the dies of one wafer; x, y and values have the same shape."""

    title: str
    x: FloatArray
    y: FloatArray
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Pattern:
    """Maps of ``what`` on a few wafers of a radius, and quantity -> share of its spread, largest first."""

    name: str
    what: str
    radius: float
    maps: tuple[WaferPicture, ...]
    shares: tuple[tuple[str, float], ...] = ()


def population_pattern(irregularity: Irregularity, spec: PopulationSpec) -> Pattern:
    """The pattern of an irregularity of ``spec``, as packaged, or as the prober measures it where it acts there alone."""
    name = irregularity.name
    rest = {other: values for other, values in spec.irregularity.items() if other != name}
    without = msgspec.structs.replace(spec, irregularity=rest)
    count = len(die_centres(spec.wafer)) * spec.wafer.lots_per_batch * spec.wafer.wafers_per_lot
    whole, bare = draw(spec, _SEED, 0, count), draw(without, _SEED, 0, count)
    probe = irregularity.stage == "probe"
    with_it, without_it = _quantities(whole, probe), _quantities(bare, probe)
    changes = {key: _difference(key, with_it[key], without_it[key]) for key in with_it}
    shares = {key: _rms(change) / (_spread(key, with_it[key]) or 1.0) for key, change in changes.items()}
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    shown = ranked[0][0]
    wafers = sorted(set(whole.wafer))
    chosen = wafers[: _LOTS * _WAFERS]  # names sort by lot
    maps = []
    for wafer in chosen:
        at = np.array([one == wafer for one in whole.wafer])
        maps.append(WaferPicture(wafer, whole.die_x_mm[at], whole.die_y_mm[at], changes[shown][at]))
    what = f"change of {shown} [{_UNITS.get(shown, '1')}]"
    bars = tuple((key, share) for key, share in ranked[:_BARS] if share > _LEAST_SHARE)
    return Pattern(name, what, spec.wafer.diameter_mm / 2.0, tuple(maps), bars)


def generic_pattern(generic: GenericIrregularity, spec: PopulationSpec) -> Pattern:
    """One draw of the first part of a generic irregularity, in units of its scale."""
    lot = _empty_lot(spec, ("y1", "y2") if "quantities" in generic.needs else ("y1",))
    part = generic.parts(lot, np.ones(len(lot.quantities)))[0]
    random = np.random.default_rng(_SEED)
    if isinstance(part, RandomPart):
        units = np.arange(len(lot.device)) if part.level == "device" else lot.codes(part.level)
        if part.field_mm is not None:
            factor = field_factor(spec.wafer, part.field_mm)
            fields = np.concatenate([factor @ random.standard_normal(len(factor)) for _ in range(_LOTS * _WAFERS)])
            values = part.columns[:, 0, 0] * fields
        else:
            drawn = random.standard_normal((int(units.max()) + 1, part.columns.shape[2]))
            values = np.sum(part.columns[:, 0] * drawn[units], axis=1)
    else:
        values = part.columns[:, 0] @ np.linspace(1.0, 0.4, part.columns.shape[2])
    wafers = dict.fromkeys(lot.wafers)
    maps = []
    for wafer in wafers:
        at = np.array([one == wafer for one in lot.wafers])
        maps.append(WaferPicture(wafer.replace("/", " "), lot.x_mm[at], lot.y_mm[at], values[at]))
    return Pattern(generic.name, "change, in units of its size", lot.radius_mm, tuple(maps))


def parts_alike(spec: PopulationSpec) -> tuple[tuple[str, ...], ...]:
    """Random parts of the irregularities that no measured lot can tell apart: same level, proportional covariance."""
    parts = population_at(trial_spec(spec), _empty_lot(spec, COORDINATES)).model.random
    found = (tuple(name for name, _ in part.shares) for part in merged(parts))
    return tuple(names for names in found if len(names) > 1)


def _empty_lot(spec: PopulationSpec, quantities: tuple[str, ...]) -> MeasuredLot:
    """Two lots of two wafers, tested by two testers in turn, with every die."""
    centres = die_centres(spec.wafer)
    dies, wafers = len(centres), _LOTS * _WAFERS
    n = dies * wafers
    wafer = np.repeat(np.arange(wafers), dies)
    labels = {
        "lot": tuple(f"L{k // _WAFERS + 1}" for k in wafer.tolist()),
        "wafer": tuple(f"W{k % _WAFERS + 1}" for k in wafer.tolist()),
        "tester": tuple(f"T{k % 2 + 1}" for k in wafer.tolist()),
    }
    x, y = np.tile(centres, (wafers, 1)).T
    return MeasuredLot(
        name="lot",
        quantities=quantities,
        units=("1",) * len(quantities),
        values=np.zeros((n, len(quantities))),
        covariance=np.zeros((n, len(quantities), len(quantities))),
        labels=labels,
        x_mm=x,
        y_mm=y,
        radius_mm=spec.wafer.diameter_mm / 2.0,
        time=np.arange(n, dtype=np.float64),
        device=tuple(f"D{k:04d}" for k in range(n)),
    )


def _quantities(drawn: Draw, probe: bool) -> dict[str, FloatArray]:
    if probe:
        return drawn.fab
    sizes: Mapping[str, FloatArray] = {
        f"{effect}.{name}": values for effect, found in drawn.effects.items() for name, values in found.items()
    }
    return {**drawn.true, **sizes}


def _difference(name: str, after: FloatArray, before: FloatArray) -> FloatArray:
    change = after - before
    return np.asarray(np.mod(change + 90.0, 180.0) - 90.0) if name in AXES else change


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _spread(name: str, values: FloatArray) -> float:
    """Standard deviation; of an axis, that of a uniform distribution over 180 deg."""
    return 180.0 / np.sqrt(12.0) if name in AXES else float(np.std(values))
