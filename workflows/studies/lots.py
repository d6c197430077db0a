"""How often the loop for a lot is right: hidden irregularities in lots of a generator that the model does not share.

none        nothing is hidden: a name is a false alarm
one, two    irregularities of the library are hidden, each with an SNR of 10 to 100
left-out    a generic irregularity is hidden, and its file and those of its twins are taken out of the library: unknown is right
outside     a pattern of no library is hidden: unknown is right

A lot has 5 lots x 4 wafers x 40 dies, drawn device by device through ``populations.draw`` (all laws in full), with random
magnitudes of all spreads.  Patterns that are generic are added to the coordinates by formulas of this file.  The SNR is the root
of the deviance by which the true part, at its true shape, improves the refitted baseline.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.learning.lot.gyro import COORDINATES, NEEDED, UNITS, coordinates, propagated
from pipeline.learning.lot.loop import LotRung, candidates_of, deviance, first_rung, kind_of
from pipeline.learning.lot.measured import MeasuredLot, hold_out
from pipeline.learning.lot.model import FixedPart
from pipeline.learning.lot.population import Part
from pipeline.learning.lot.prepared import PreparedLot, free, prepared
from pipeline.learning.lot.table import LotTable
from populations.draw import draw
from populations.spec import PopulationSpec, load_spec

from ..lots.loop import lot_answers
from ..lots.population import population_at
from ..lots.simulate import NOISE, measured_values

LotKind = Literal["none", "one", "two", "left-out", "outside"]
KINDS: tuple[LotKind, ...] = get_args(LotKind)
LOTS, WAFERS, DIES = 5, 4, 40
SNR = (10.0, 100.0)
#: Irregularities that are hidden by leaving them out of the population file, with the parameters that set their size.
PHYSICAL = {
    "sidewall_tilt": ("edge_deg",),
    "electrode_gap": ("lot_pct", "wafer_pct", "die_pct"),
    "damping_anisotropy": ("die",),
    "residual_anisotropy": ("die_pct",),
    "lid_leak": ("fraction",),
}


@dataclass(frozen=True)
class HiddenPattern:
    """A pattern: name, the parts that describe it, and its shape at (x, y) [radius] of wafer w of W in lot l, each (n,)."""

    name: str
    twins: tuple[str, ...]
    shape: Callable[[FloatArray, FloatArray, FloatArray, FloatArray, np.random.Generator], FloatArray]


def _per(unit: FloatArray, g: np.random.Generator, columns: int = 1) -> FloatArray:
    """(columns, n) standard normals that the devices of a unit share."""
    _, back = np.unique(unit, return_inverse=True)
    return g.standard_normal((columns, int(back.max()) + 1))[:, back]


def _gradient(x: FloatArray, y: FloatArray, w: FloatArray, l: FloatArray, g: np.random.Generator) -> FloatArray:
    a, b = _per(w, g, 2)
    return a * x + b * y


GENERIC: tuple[HiddenPattern, ...] = (
    HiddenPattern("lot_shift", ("wafer_shift",), lambda x, y, w, l, g: _per(l, g)[0]),
    HiddenPattern("wafer_shift", ("lot_shift",), lambda x, y, w, l, g: _per(w, g)[0]),
    HiddenPattern("gradient", (), _gradient),
    HiddenPattern("fixed_gradient", ("gradient",), lambda x, y, w, l, g: x * np.cos(1.0) + y * np.sin(1.0)),
    HiddenPattern("bow", ("fixed_bow",), lambda x, y, w, l, g: _per(w, g)[0] * (x * x + y * y - 0.5)),
    HiddenPattern("fixed_bow", ("bow", "edge_ring"), lambda x, y, w, l, g: x * x + y * y - 0.5),
    HiddenPattern("edge_ring", (), lambda x, y, w, l, g: (np.hypot(x, y) > 0.9 * np.hypot(x, y).max()).astype(float)),
    HiddenPattern("two_theta", ("sidewall_tilt",), lambda x, y, w, l, g: x * x - y * y),
    HiddenPattern("drift", ("wafer_shift", "lot_shift"), lambda x, y, w, l, g: w / w.max() - 0.5),
    HiddenPattern("rows_and_columns", (), lambda x, y, w, l, g: np.where(_step(x) % 2 == 0, 1.0, -1.0)),
    HiddenPattern("reticle", (), lambda x, y, w, l, g: np.where((_step(x) + _step(y)) % 2 == 0, 1.0, -1.0)),
)
#: Patterns of no library.
OUTSIDE: tuple[HiddenPattern, ...] = (
    HiddenPattern("stripes", (), lambda x, y, w, l, g: np.sin(2.0 * np.pi * (x + 0.3 * y) / 0.55)),
    HiddenPattern("middle_ring", (), lambda x, y, w, l, g: (np.abs(np.hypot(x, y) - 0.5) < 0.12).astype(float)),
    HiddenPattern("half_wafer", (), lambda x, y, w, l, g: np.sign(np.sin(3.0 * np.arctan2(y, x)) + 1e-9)),
    HiddenPattern("spots", (), lambda x, y, w, l, g: _per(_step(x) * 1000.0 + _step(y), g)[0]),
)
#: The coordinates that a generic pattern may be hidden in, with the spread of a device.
IN = {
    "anisotropy_x": 3.3e-3,
    "ln_damping": 0.25,
    "damping_anisotropy_y": 0.21,
    "ln_rocking_gain": 1.1e-2,
    "sense_imbalance": 5e-3,
}


def _step(position: FloatArray) -> FloatArray:
    return np.round(position * 50.0 / 8.0)


@dataclass(frozen=True, eq=False)
class HiddenLot:
    """A lot with what is hidden in it, and the population file that the loop starts from.

    ``patterns`` are the generic patterns that were added, as they were drawn.
    """

    lot: MeasuredLot
    spec: PopulationSpec
    truth: tuple[str, ...]
    accepted: tuple[frozenset[str], ...]
    without: tuple[str, ...]
    patterns: tuple[FixedPart, ...] = ()


def hidden_lot(kind: LotKind, seed: int, size: float = 1.0, truth: int | None = None) -> HiddenLot:
    """One lot; ``size`` multiplies what is hidden, ``truth`` chooses it (default: by the seed)."""
    g = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, KINDS.index(kind)])))
    wafer = msgspec.structs.replace(load_spec(None).wafer, lots_per_batch=LOTS, wafers_per_lot=WAFERS)
    spec = _with_random_magnitudes(msgspec.structs.replace(load_spec(None), wafer=wafer), g)
    library = [*PHYSICAL, *(one.name for one in GENERIC)]
    count = {"none": 0, "one": 1, "two": 2}.get(kind, 0)
    first = int(g.integers(len(library))) if truth is None else truth
    chosen = [library[(first + 5 * k) % len(library)] for k in range(count)]
    file, made = spec, spec
    for name in chosen:
        if name in PHYSICAL:
            file = msgspec.structs.replace(file, irregularity={k: v for k, v in file.irregularity.items() if k != name})
            made = made.with_values({f"{name}.{p}": _within(made, name, p, size) for p in PHYSICAL[name]})
    lot = _measured(made, seed, g)
    patterns = [one for one in GENERIC if one.name in chosen]
    if kind == "left-out":
        patterns = [
            one for one in GENERIC if one.name in ("edge_ring", "two_theta", "rows_and_columns", "reticle", "gradient")
        ]
        patterns = [patterns[first % len(patterns)]]
    elif kind == "outside":
        patterns = [OUTSIDE[first % len(OUTSIDE)]]
    names: list[str] = [name for name in chosen if name in PHYSICAL]
    accepted = [frozenset({name, *_physical_twins(name)}) for name in names]
    drawn: list[FixedPart] = []
    for one in patterns:
        quantity = list(IN)[int(g.integers(len(IN)))]
        before = lot.values
        lot = _added(lot, one, quantity, 0.3 * size * IN[quantity], g)
        drawn.append(FixedPart(one.name, (lot.values - before)[..., None]))
        names.append(f"{one.name}({quantity})")
        accepted.append(frozenset({one.name, *one.twins}))
    # A smooth field is no twin: it is a probe.
    without = (patterns[0].name, *patterns[0].twins) if kind == "left-out" else ()
    return HiddenLot(hold_out(lot), file, tuple(names), tuple(accepted), without, tuple(drawn))


def _physical_twins(name: str) -> tuple[str, ...]:
    """Generic irregularities that describe the same as a physical one."""
    return {
        "sidewall_tilt": ("two_theta",),
        "electrode_gap": ("lot_shift", "wafer_shift", "correlation", "device_spread"),
        "damping_anisotropy": ("device_spread",),
        "residual_anisotropy": ("lot_shift", "wafer_shift", "device_spread"),
        "lid_leak": ("outliers",),
    }[name]


def _within(spec: PopulationSpec, name: str, parameter: str, size: float) -> float:
    return min(spec.irregularity[name][parameter] * size, 0.9 if name == "lid_leak" else 5.0)


def _with_random_magnitudes(spec: PopulationSpec, g: np.random.Generator) -> PopulationSpec:
    """Each spread and bow times exp(N(0, 0.25)); ratios, lengths and laws as they are."""
    kept = (
        "correlation",
        "limit",
        "field_length_mm",
        "hz_per_mpa",
        "mean_ratio",
        "tcf_ppm_per_k",
        "ln_mean",
        "ln_spread",
    )
    tables = {
        name: {k: v if k in kept else v * float(np.exp(0.25 * g.standard_normal())) for k, v in values.items()}
        for name, values in spec.irregularity.items()
    }
    return msgspec.structs.replace(spec, irregularity=tables)


def _measured(spec: PopulationSpec, seed: int, g: np.random.Generator) -> MeasuredLot:
    made = draw(spec, seed, 0, LOTS * WAFERS * DIES)
    n = len(made.index)
    values = measured_values(made, g)
    covariance = propagated(values, {name: np.full(n, NOISE[name]) for name in NEEDED})
    labels = {"lot": made.lot, "wafer": made.wafer}
    x, y, none = made.die_x_mm, made.die_y_mm, np.full(n, np.nan)
    radius = spec.wafer.diameter_mm / 2.0
    found = coordinates(values)
    return MeasuredLot("hidden", COORDINATES, UNITS, found, covariance, labels, x, y, radius, none, made.device_id)


def _added(lot: MeasuredLot, one: HiddenPattern, quantity: str, size: float, g: np.random.Generator) -> MeasuredLot:
    wafer, lots = lot.codes("wafer").astype(np.float64), lot.codes("lot").astype(np.float64)
    values = lot.values.copy()
    values[:, COORDINATES.index(quantity)] += size * one.shape(lot.x, lot.y, wafer, lots, g)
    return replace(lot, values=values)


def snr_of(ready: PreparedLot, hidden: HiddenLot, parts: tuple[Part, ...]) -> float:
    """Root of the deviance that the true part takes from the refitted baseline; the smallest of those that are hidden."""
    base = first_rung(ready)
    groups: list[list[Part]] = [[pattern] for pattern in hidden.patterns]
    groups += [[part for part in parts if kind_of(part.name) == name] for name in hidden.truth if name in PHYSICAL]
    each = [max((np.sqrt(max(_fall(ready, base, part), 0.0)) for part in group), default=0.0) for group in groups]
    return float(min(each, default=0.0))


def _fall(ready: PreparedLot, base: LotRung, part: Part) -> float:
    model = base.model.with_part(part)
    start = base.fit.variances if isinstance(part, FixedPart) else np.append(base.fit.variances, part.start)
    fit = ready.fit(model, np.maximum(start, 1e-4))
    return deviance(base) - deviance(LotRung(part.name, ready, fit, model, base.outcome, 0.0, None))


def judged(kind: LotKind, seed: int) -> dict[str, Any]:
    """One row of the study: what was hidden, what was found, whether that is right."""
    start = time.process_time()
    hidden, snr = _sized(kind, seed)
    table = LotTable(hidden.lot, True, "package", {})
    answers = lot_answers(table, hidden.spec, without=hidden.without)
    found = answers.refinement
    named = [kind_of(name) for name in found.irregularities]
    classes = [{kind_of(name) for name in group} for group in found.classes]
    each = [next((group for group in classes if name in group), {name}) for name in named]
    right = [any(group & names for group in each) for names in hidden.accepted]
    wrong = [name for name, group in zip(named, each) if not any(group & names for names in hidden.accepted)]
    spreads = found.spreads
    return {
        "kind": kind,
        "seed": seed,
        "truth": list(hidden.truth),
        "snr": snr,
        "verdict": found.verdict,
        "named": list(found.irregularities),
        "classes": [list(group) for group in found.classes],
        "right": right,
        "wrong": wrong,
        "largest_class": max((len(group) for group in each), default=0),
        "forecast": [None if rung.forecast is None else msgspec.to_builtins(rung.forecast) for rung in found.ladder],
        "spread_ratios": {name: [one.ratio, one.low, one.high] for name, one in spreads.items()},
        "cpu_s": time.process_time() - start,
    }


def _sized(kind: LotKind, seed: int) -> tuple[HiddenLot, float | None]:
    """A lot whose hidden part has an SNR within ``SNR``: its size is doubled or halved until it has."""
    size, hidden = 1.0, hidden_lot(kind, seed)
    if kind == "none":
        return hidden, None
    snr = 0.0
    for _ in range(7):
        population = population_at(hidden.spec, hidden.lot)
        ready = prepared(hidden.lot, population)
        snr = snr_of(ready, hidden, candidates_of(ready, free(population.model)))
        # A leak is a mixture and has no part whose deviance is its SNR; of two, the larger may exceed the range.
        if "lid_leak" in hidden.truth or (snr >= SNR[0] and (kind == "two" or snr <= SNR[1])):
            break
        size *= 2.0 if snr < SNR[0] else 0.4
        hidden = hidden_lot(kind, seed, size)
    return hidden, snr


def study(kinds: tuple[LotKind, ...], count: int, out: Path, seed: int) -> Iterator[dict[str, Any]]:
    """Rows of ``count`` lots of each kind; rows that ``out`` (JSON lines) holds are not computed again."""
    done: dict[tuple[str, int], dict[str, Any]] = {}
    if out.exists():
        for line in out.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            done[(row["kind"], row["seed"])] = row
    out.parent.mkdir(parents=True, exist_ok=True)
    for kind in kinds:
        for k in range(count):
            if (kind, seed + k) not in done:
                row = judged(kind, seed + k)
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
                done[(kind, seed + k)] = row
            yield done[(kind, seed + k)]
