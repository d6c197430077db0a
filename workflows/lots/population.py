"""A population file at the devices of a measured lot, as the arrays that ``pipeline.learning.lot`` works on.

``pipeline`` may not import ``populations``; this is where the two meet.

A candidate is every random number and every pattern that the population would have with all irregularities of the library at
trial sizes, and does not have with its file.  A trial size is that of the shipped population where it has one, else ``TRIAL`` of
the upper end of the declared range.

Shapes: n devices, q quantities, 12 coordinates of ``gyro``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from pipeline.arrays import FloatArray, IntArray
from pipeline.errors import ConfigError, GyroscreenError, UsageError
from pipeline.learning.lot.gyro import COORDINATES, coordinates
from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.model import FixedPart, LotLevel, LotModel, RandomPart
from pipeline.learning.lot.population import DeviceMixture, LotPopulation
from populations.irregularity import Irregularity, Stage, find
from populations.linear import LinearPopulation, LinearStream, curvature, linearized
from populations.spec import PopulationSpec, load_spec

#: Share of the upper end of a parameter's range that a candidate has, where the shipped population has no value.
TRIAL = 0.02
#: Devices that the linearization is checked with.
CHECKED = 400
LEVELS: Mapping[str, LotLevel] = {"lot": "lot", "wafer": "wafer", "die": "device", "package": "device", "fixed": "all"}


def population_at(spec: PopulationSpec, lot: MeasuredLot, stage: Stage = "package") -> LotPopulation:
    """The population at the devices of ``lot``, with the candidates that its file lacks.

    Raises
    ------
    UsageError : the quantities of the lot are none of the coordinates of a gyro.
    ConfigError : an irregularity gives invalid changes.
    """
    if not set(lot.quantities) <= set(COORDINATES):
        raise UsageError(
            "a population file describes gyros, and this table has other quantities",
            value=", ".join(lot.quantities)[:120],
            allowed="a run, or a lot.toml with gyro = true",
            next_step="leave --population out: the generic irregularities work for any table",
        )
    chosen = np.array([COORDINATES.index(name) for name in lot.quantities], dtype=np.int64)
    x, y = np.nan_to_num(lot.x_mm), np.nan_to_num(lot.y_mm)
    linear = linearized(spec, x, y, stage, coordinates)
    step = max(1, len(x) // CHECKED)
    left = curvature(spec, x[::step], y[::step], stage, coordinates, 0)[:, chosen]
    trial = trial_spec(spec)
    larger = linearized(trial, x, y, stage, coordinates)
    return LotPopulation(
        name=spec.name,
        model=LotModel(
            fixed=_patterns(linear, linear.patterns, chosen),
            random=tuple(_part(stream, chosen) for stream in linear.streams),
            offset=linear.base[:, chosen],
        ),
        candidates=_absent(linear, larger, chosen),
        mixtures=_mixtures(linear, chosen),
        absent_mixtures=tuple(
            one
            for one in _mixtures(larger, chosen)
            if one.name not in {known.irregularity for known in linear.switched}
        ),
        curvature=np.cov(left.T).reshape(len(chosen), len(chosen)),
    )


def _part(stream: LinearStream, chosen: IntArray) -> RandomPart:
    return RandomPart(stream.name, LEVELS[stream.level], stream.columns[:, chosen], field_mm=stream.field_mm)


def _mixtures(linear: LinearPopulation, chosen: IntArray) -> tuple[DeviceMixture, ...]:
    return tuple(
        DeviceMixture(one.irregularity, one.mean[:, chosen], one.columns[:, chosen], one.share)
        for one in linear.switched
    )


def _patterns(linear: LinearPopulation, patterns: Mapping[str, FloatArray], chosen: IntArray) -> tuple[FixedPart, ...]:
    """What each irregularity changes with its random numbers at zero, where that differs over the wafer."""
    return tuple(
        FixedPart(f"{name}.pattern", own[:, chosen, None], size=1.0)
        for name, own in patterns.items()
        if float(np.ptp(own[:, chosen], axis=0).max()) > 1e-9
    )


def _absent(linear: LinearPopulation, larger: LinearPopulation, chosen: IntArray) -> tuple[RandomPart | FixedPart, ...]:
    known = {(s.irregularity, s.level, s.label) for s in linear.streams}
    random = tuple(
        _part(stream, chosen)
        for stream in larger.streams
        if (stream.irregularity, stream.level, stream.label) not in known and np.any(stream.columns[:, chosen] != 0.0)
    )
    had = {part.name for part in _patterns(linear, linear.patterns, chosen)}
    # The file has none of them, so that their coefficients count from zero.
    fixed = tuple(
        replace(part, size=None) for part in _patterns(larger, larger.patterns, chosen) if part.name not in had
    )
    return (*random, *fixed)


def trial_spec(spec: PopulationSpec) -> PopulationSpec:
    """The population with every null parameter of every irregularity of the library at a trial size."""
    shipped = {one.name: values for one, values in load_spec(None).found()}
    tables = {name: dict(values) for name, values in spec.irregularity.items()}
    for name, one in find(spec.irregularity_folders).items():
        tables[name] = {**_trials(one, shipped.get(name, {}), tables.get(name, {})), **_set(tables.get(name, {}))}
    return msgspec.structs.replace(spec, irregularity=tables)


def trial_values(spec: PopulationSpec, name: str) -> dict[str, float]:
    """Every parameter of an irregularity that the population lacks or holds at null, at its trial size."""
    shipped = {one.name: values for one, values in load_spec(None).found()}
    return _trials(find(spec.irregularity_folders)[name], shipped.get(name, {}), spec.irregularity.get(name, {}))


def _set(values: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if value != 0.0}


def _trials(one: Irregularity, shipped: Mapping[str, float], own: Mapping[str, float]) -> dict[str, float]:
    found: dict[str, float] = {}
    for parameter in one.parameters:
        if parameter.null is None and parameter.name not in own:
            found[parameter.name] = shipped.get(parameter.name, 0.5 * (parameter.low + parameter.high))
        elif parameter.null == 0.0 and own.get(parameter.name, 0.0) == 0.0:
            found[parameter.name] = shipped.get(parameter.name) or TRIAL * parameter.high
    return found


def refined_spec(spec: PopulationSpec, factors: Mapping[str, float], added: Sequence[str]) -> PopulationSpec:
    """The population with its spreads multiplied by ``factors`` (part -> ratio), and with the added irregularities.

    Parameters follow from the factors by their elasticities d ln(part) / d ln(parameter), in least squares.

    Raises
    ------
    ConfigError : a value leaves its declared range.
    """
    trial = trial_spec(spec)
    names = {name.partition(".")[0] for name in (*factors, *added)}
    tables = {name: dict(values) for name, values in spec.irregularity.items()}
    for name in sorted(names & set(trial.irregularity)):
        grown = {**tables.get(name, {}), **_needed(trial, tables.get(name), name, added)}
        logs = {part: np.log(max(f, 1e-3)) for part, f in factors.items() if part.partition(".")[0] == name}
        tables[name] = _scaled(spec, name, grown, logs)
    return msgspec.structs.replace(spec, irregularity=tables)


def _needed(
    trial: PopulationSpec, own: Mapping[str, float] | None, name: str, added: Sequence[str]
) -> dict[str, float]:
    """Parameters at trial size that the added parts of an irregularity need beside its own."""
    wanted = {part.partition(".")[2] for part in added if part.partition(".")[0] == name}
    if not wanted:
        return {}
    found = _elasticities(trial, name, trial.irregularity[name])
    present = own or {}
    return {
        parameter: trial.irregularity[name][parameter]
        for parameter, values in found.items()
        if parameter not in _set(present) and any(values.get(f"{name}.{part}", 0.0) != 0.0 for part in wanted)
    }


def _scaled(
    spec: PopulationSpec, name: str, values: Mapping[str, float], logs: Mapping[str, float]
) -> dict[str, float]:
    found = _elasticities(spec, name, values)
    parameters = [p for p in found if any(abs(found[p].get(part, 0.0)) > 1e-3 for part in logs)]
    parts = [part for part in logs if any(part in found[p] for p in parameters)]
    if not parameters or not parts:
        return dict(values)
    matrix = np.array([[found[p].get(part, 0.0) for p in parameters] for part in parts])
    steps = np.linalg.lstsq(matrix, np.array([logs[part] for part in parts]), rcond=1e-6)[0]
    ranges = {p.name: p for p in find(spec.irregularity_folders)[name].parameters}
    moved = {
        p: float(np.clip(values[p] * np.exp(step), ranges[p].low, ranges[p].high)) for p, step in zip(parameters, steps)
    }
    return {**values, **moved}


def _elasticities(spec: PopulationSpec, name: str, values: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """parameter -> part -> d ln(size of the part) / d ln(parameter), over dies from the centre to the edge."""
    rho = np.linspace(0.05, 0.95, 10) * spec.wafer.diameter_mm / 2.0
    place = rho * np.cos(2.0 + rho), rho * np.sin(2.0 + rho)
    stage = find(spec.irregularity_folders)[name].stage

    def sizes(own: Mapping[str, float]) -> dict[str, float]:
        alone = msgspec.structs.replace(spec, irregularity={name: dict(own)})
        linear = linearized(alone, *place, "probe" if stage == "probe" else "package", coordinates)
        found = {s.name: float(np.linalg.norm(s.columns)) for s in linear.streams}
        found |= {f"{n}.pattern": float(np.linalg.norm(p)) for n, p in linear.patterns.items()}
        return {part: size for part, size in found.items() if size > 0.0}

    try:
        base = sizes(values)
    except GyroscreenError as error:
        raise ConfigError(f"population {spec.name}: [irregularity.{name}] {error}") from error
    found: dict[str, dict[str, float]] = {}
    for parameter, value in values.items():
        if value == 0.0:
            continue
        other = sizes({**values, parameter: value * 1.1})
        slopes = {part: np.log(other[part] / base[part]) / np.log(1.1) for part in base if part in other}
        found[parameter] = {part: round(float(s), 2) for part, s in slopes.items() if abs(s) > 1e-2}
    return found
