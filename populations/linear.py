"""A population to first order: what each random number of each irregularity changes in a device.

    y = y0 + sum over streams s, entries k of  L_sk z_sk,        L_sk = (y(z_sk = 1) - y(z_sk = -1)) / 2

y are coordinates of the device, a function of its parameters that the caller gives; y0 is the device with every random number at
zero.  The secant over +-1 sd keeps the average slope of a curved law.  A stream belongs to a lot, a wafer, a die, a package or
to all devices, and is named as in ``numbers``: "irregularity/level/label".

A stream that is compared with a share (a leaking lid) switches a change on: ``switched`` is y with the change less y0.

Shapes: B devices, q coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import FloatArray, IntArray

from .assembly import combine, parameters
from .irregularity import Change, Irregularity, Stage
from .layout import Places
from .nominal import Wafer
from .site import Site
from .spec import PopulationSpec

Coordinates = Callable[[Mapping[str, FloatArray]], FloatArray]
#: A coordinate that changes by less than this, relative to its largest change, is rounding.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class LinearStream:
    """One random number, or a few that are alike, of an irregularity.

    Parameters
    ----------
    irregularity, level, label : of the stream; ``level`` is "lot", "wafer", "die", "package" or "fixed" (all devices).
    columns : (B, q, m) change of the coordinates by each of m independent standard normals.
    field_mm : correlation length [mm] of a Gaussian process on each wafer (then m = 1), else ``None``.
    """

    irregularity: str
    level: str
    label: str
    columns: FloatArray
    field_mm: float | None = None

    @property
    def name(self) -> str:
        """ "irregularity.level" or "irregularity.label", as a report names it."""
        return f"{self.irregularity}.{self.label or self.level}"


@dataclass(frozen=True, eq=False)
class LinearSwitch:
    """A change that a share of the devices has: its mean (B, q), columns (B, q, m) of its standard normals, and the share."""

    irregularity: str
    mean: FloatArray
    columns: FloatArray
    share: float


@dataclass(frozen=True, eq=False)
class LinearPopulation:
    """See the module.

    Parameters
    ----------
    base : (B, q) y0.
    nominal : (B, q) the device without any irregularity.
    streams : all that change a coordinate.
    patterns : irregularity -> (B, q) what it changes with its random numbers at zero (a bow, a mean).
    switched : what an irregularity changes when its share applies.
    """

    base: FloatArray
    nominal: FloatArray
    streams: tuple[LinearStream, ...]
    patterns: Mapping[str, FloatArray]
    switched: tuple[LinearSwitch, ...]


@dataclass(frozen=True)
class _ChosenNumbers:
    """Zero, except in one entry of one stream; remembers what was read."""

    chosen: str = ""
    entry: int = 0
    value: float = 0.0
    uniform_value: float = 1.0 - 2.0**-53
    read: dict[str, int] = field(default_factory=dict)
    lengths: dict[str, float] = field(default_factory=dict)
    uniforms: set[str] = field(default_factory=set)

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """(size, B)."""
        self.read[stream] = max(size, self.read.get(stream, 0))
        found = np.zeros((size, len(keys)))
        if stream == self.chosen and self.entry < size:
            found[self.entry] = self.value
        return found

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """(B,)."""
        self.uniforms.add(stream)
        return np.full(len(keys), self.uniform_value)

    def fixed(self, stream: str, size: int) -> FloatArray:
        """(size,)."""
        return np.ascontiguousarray(self.normal(stream, np.zeros(1, dtype=np.int64), size)[:, 0])

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """(B,)."""
        self.lengths[stream] = length_mm
        return np.ascontiguousarray(self.normal(stream, keys, 1)[0])


def linearized(
    spec: PopulationSpec, x_mm: FloatArray, y_mm: FloatArray, stage: Stage, coordinates: Coordinates
) -> LinearPopulation:
    """The population to first order for dies at ``x_mm``, ``y_mm`` (B,) [mm].

    Parameters
    ----------
    stage : "package" for packaged devices, "probe" for dies in the wafer prober.
    coordinates : parameters by name, each (B,), to (B, q).

    Raises
    ------
    ConfigError : an irregularity gives invalid changes, or a device has no positive stiffness.
    """
    count = len(x_mm)
    zero = np.zeros(count, dtype=np.int64)
    placed = Places(lot=zero, wafer=zero, wafer_in_lot=zero, die=zero, x_mm=x_mm, y_mm=y_mm)
    stages = ("fabrication", stage)
    present = [(one, values) for one, values in spec.found() if one.stage in stages]
    device, operating = spec.device, spec.operating
    packaged = stage == "package"
    bias = spec.bias_ratio if packaged else 1.0
    pressure = operating.lid_pressure_pa if packaged else operating.probe_pressure_pa

    def change(one: Irregularity, values: Mapping[str, float], numbers: _ChosenNumbers) -> Change:
        site = Site(one.name, numbers, np.arange(count), placed, device, spec.wafer, operating)
        return one.act(values, site)

    def seen(changes: Mapping[str, Change]) -> FloatArray:
        whole = combine(changes.items(), count, len(device.spring_azimuth_deg))
        return coordinates(parameters(device, whole, bias, pressure / device.nominal_pressure_pa))

    recorders = {one.name: _ChosenNumbers() for one, _ in present}
    at_zero = {one.name: change(one, values, recorders[one.name]) for one, values in present}
    base = seen(at_zero)
    streams: list[LinearStream] = []
    patterns: dict[str, FloatArray] = {}
    switched: list[LinearSwitch] = []
    for one, values in present:
        read = recorders[one.name]

        def moved(
            stream: str,
            entry: int,
            value: float,
            uniform: float = 1.0 - 2.0**-53,
            one: Irregularity = one,
            values: Mapping[str, float] = values,
        ) -> FloatArray:
            numbers = _ChosenNumbers(stream, entry, value, uniform)
            return seen({**at_zero, one.name: change(one, values, numbers)})

        for stream, size in read.read.items():
            columns = np.stack([0.5 * (moved(stream, k, 1.0) - moved(stream, k, -1.0)) for k in range(size)], axis=-1)
            _, level, label = stream.split("/")
            if np.abs(columns).max() > ROUNDING:
                columns = np.where(np.abs(columns) > ROUNDING, columns, 0.0)
                streams.append(LinearStream(one.name, level, label, columns, read.lengths.get(stream)))
        patterns[one.name] = base - seen({name: c for name, c in at_zero.items() if name != one.name})
        if read.uniforms:
            on = moved("", 0, 0.0, 0.0)
            slopes = [
                0.5 * (moved(stream, k, 1.0, 0.0) - moved(stream, k, -1.0, 0.0))
                for stream, size in read.read.items()
                for k in range(size)
            ]
            share = _share(moved, on)
            if np.abs(on - base).max() > ROUNDING and share > 0.0:
                own = np.stack(slopes, axis=-1) if slopes else np.zeros((*base.shape, 0))
                switched.append(LinearSwitch(one.name, on - base, own, share))
    return LinearPopulation(base, seen({}), tuple(streams), patterns, tuple(switched))


def _share(moved: Callable[[str, int, float, float], FloatArray], on: FloatArray) -> float:
    """The number that a uniform one is compared with, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.array_equal(moved("", 0, 0.0, middle), on) else (low, middle)
    return low


@dataclass(frozen=True)
class _FreshNumbers:
    """Independent standard normals for each device, which are kept by stream."""

    generator: np.random.Generator
    drawn: dict[str, FloatArray] = field(default_factory=dict)

    def normal(self, stream: str, keys: IntArray, size: int) -> FloatArray:
        """(size, B)."""
        if stream not in self.drawn:
            self.drawn[stream] = self.generator.standard_normal((size, len(keys)))
        return self.drawn[stream]

    def uniform(self, stream: str, keys: IntArray) -> FloatArray:
        """(B,)."""
        return np.full(len(keys), 1.0 - 2.0**-53)

    def fixed(self, stream: str, size: int) -> FloatArray:
        """(size,), zero: it is the same for all devices."""
        return np.zeros(size)

    def field(self, stream: str, keys: IntArray, die: IntArray, wafer: Wafer, length_mm: float) -> FloatArray:
        """(B,)."""
        return np.ascontiguousarray(self.normal(stream, keys, 1)[0])


def curvature(
    spec: PopulationSpec, x_mm: FloatArray, y_mm: FloatArray, stage: Stage, coordinates: Coordinates, seed: int
) -> FloatArray:
    """What the first order leaves (B, q): drawn devices, with all their numbers independent, less their linear prediction."""
    count = len(x_mm)
    linear = linearized(spec, x_mm, y_mm, stage, coordinates)
    numbers = _FreshNumbers(np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed))))
    zero = np.zeros(count, dtype=np.int64)
    placed = Places(lot=zero, wafer=zero, wafer_in_lot=zero, die=zero, x_mm=x_mm, y_mm=y_mm)
    changes = {
        one.name: one.act(
            values, Site(one.name, numbers, np.arange(count), placed, spec.device, spec.wafer, spec.operating)
        )
        for one, values in spec.found()
        if one.stage in ("fabrication", stage)
    }
    packaged = stage == "package"
    bias = spec.bias_ratio if packaged else 1.0
    pressure = spec.operating.lid_pressure_pa if packaged else spec.operating.probe_pressure_pa
    whole = combine(changes.items(), count, len(spec.device.spring_azimuth_deg))
    drawn = coordinates(parameters(spec.device, whole, bias, pressure / spec.device.nominal_pressure_pa))
    predicted = linear.base.copy()
    for stream in linear.streams:
        own = numbers.drawn.get(f"{stream.irregularity}/{stream.level}/{stream.label}")
        if own is not None:
            predicted += np.einsum("bqm,mb->bq", stream.columns, own)
    return np.asarray(drawn - predicted)
