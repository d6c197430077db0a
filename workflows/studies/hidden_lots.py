"""Lots with hidden irregularities, from a generator that the model of the loop does not share.

A lot has 5 lots x 4 wafers x 40 dies, drawn device by device through ``populations.draw`` (all laws in full), with random
magnitudes of all spreads.  Irregularities of the library are hidden by leaving them out of the population file.
Generic patterns, and patterns of no library, are added to the coordinates by formulas of this file.

Shapes: n devices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import msgspec
import numpy as np

from pipeline.arrays import FloatArray
from pipeline.learning.lot.gyro import COORDINATES, NEEDED, UNITS, coordinates, propagated
from pipeline.learning.lot.measured import MeasuredLot, hold_out
from pipeline.learning.lot.model import FixedPart
from populations.draw import Draw, draw
from populations.irregularity import find
from populations.spec import PopulationSpec, load_spec

from ..lots.simulate import NOISE, measured_values

LotKind = Literal["none", "one", "two", "left-out", "outside"]
KINDS: tuple[LotKind, ...] = get_args(LotKind)
LOTS, WAFERS, DIES = 5, 4, 40
#: Irregularities that are hidden by leaving them out of the population file, with the parameters that set their size.
PHYSICAL = {
    "sidewall_tilt": ("edge_deg",),
    "electrode_gap": ("lot_pct", "wafer_pct", "die_pct"),
    "damping_anisotropy": ("die",),
    "residual_anisotropy": ("lot_ratio", "wafer_ratio"),
    "lid_leak": ("fraction",),
}

#: Largest share of leaking lids: of a lot where most lids leak, the others are the exception.
MOST = 0.15


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
#: Patterns that are left out of the library: without their files, no other candidate describes them.
LEFT_OUT = ("edge_ring", "two_theta", "rows_and_columns", "reticle", "gradient")
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

    ``patterns`` are the generic patterns that were added, as they were drawn, by the name of the truth.
    """

    lot: MeasuredLot
    spec: PopulationSpec
    truth: tuple[str, ...]
    accepted: tuple[frozenset[str], ...]
    without: tuple[str, ...]
    patterns: Mapping[str, FixedPart]


def hidden_lot(kind: LotKind, seed: int, sizes: Sequence[float] = (1.0, 1.0), turn: int = 0) -> HiddenLot:
    """One lot; ``sizes`` multiply what is hidden, ``turn`` chooses the quantity of generic patterns."""
    g = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, KINDS.index(kind)])))
    wafer = msgspec.structs.replace(load_spec(None).wafer, lots_per_batch=LOTS, wafers_per_lot=WAFERS)
    spec = _with_random_magnitudes(msgspec.structs.replace(load_spec(None), wafer=wafer), g)
    chosen = _chosen(kind, seed, g)
    size = dict(zip(chosen, sizes))
    file, made = spec, spec
    physical = [name for name in chosen if name in PHYSICAL]
    for name in physical:
        file = msgspec.structs.replace(file, irregularity={k: v for k, v in file.irregularity.items() if k != name})
        made = made.with_values({f"{name}.{p}": _within(made, name, p, size[name]) for p in PHYSICAL[name]})
    lot = measured_lot("hidden", draw(made, seed, 0, LOTS * WAFERS * DIES), made, g)
    accepted = [frozenset({name, *_physical_twins(name)}) for name in physical]
    names, drawn = list(physical), dict[str, FixedPart]()
    without: tuple[str, ...] = ()
    for one in (*GENERIC, *OUTSIDE):
        if one.name not in chosen:
            continue
        quantity = list(IN)[(int(g.integers(len(IN))) + turn) % len(IN)]
        before = lot.values
        lot = _added(lot, one, quantity, 0.3 * size[one.name] * IN[quantity], g)
        names.append(f"{one.name}({quantity})")
        drawn[names[-1]] = FixedPart(one.name, (lot.values - before)[..., None])
        accepted.append(frozenset({one.name, *one.twins}))
        # A smooth field is no twin: it is a probe.
        without = (one.name, *one.twins) if kind == "left-out" else ()
    return HiddenLot(hold_out(lot), file, tuple(names), tuple(accepted), without, drawn)


def _chosen(kind: LotKind, seed: int, g: np.random.Generator) -> tuple[str, ...]:
    """Names of what is hidden: all in turn, the second of two at random."""
    library = (*PHYSICAL, *(one.name for one in GENERIC))
    if kind == "none":
        return ()
    if kind == "left-out":
        return (LEFT_OUT[seed % len(LEFT_OUT)],)
    if kind == "outside":
        return (OUTSIDE[seed % len(OUTSIDE)].name,)
    first = seed % len(library)
    if kind == "one":
        return (library[first],)
    return (library[first], library[(first + 1 + int(g.integers(len(library) - 1))) % len(library)])


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
    """The parameter times ``size``, at most the end of its declared range; ``MOST`` of the lids leak."""
    high = MOST if name == "lid_leak" else next(p.high for p in find(())[name].parameters if p.name == parameter)
    return min(spec.irregularity[name][parameter] * size, high)


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


def measured_lot(name: str, made: Draw, spec: PopulationSpec, g: np.random.Generator) -> MeasuredLot:
    """Drawn devices as a lot in the coordinates of the loop, measured with ``NOISE``."""
    n = len(made.index)
    values = measured_values(made, g)
    covariance = propagated(values, {name: np.full(n, NOISE[name]) for name in NEEDED})
    labels = {"lot": made.lot, "wafer": made.wafer}
    x, y, none = made.die_x_mm, made.die_y_mm, np.full(n, np.nan)
    radius = spec.wafer.diameter_mm / 2.0
    found = coordinates(values)
    return MeasuredLot(name, COORDINATES, UNITS, found, covariance, labels, x, y, radius, none, made.device_id)


def _added(lot: MeasuredLot, one: HiddenPattern, quantity: str, size: float, g: np.random.Generator) -> MeasuredLot:
    wafer, lots = lot.codes("wafer").astype(np.float64), lot.codes("lot").astype(np.float64)
    values = lot.values.copy()
    values[:, COORDINATES.index(quantity)] += size * one.shape(lot.x, lot.y, wafer, lots, g)
    return replace(lot, values=values)
