"""How often the questions at the end of a night are answered rightly: false alarms, and what is found.

none       tonight's lot is drawn from the population file: a departure or a drift is a false alarm
mean       one coordinate is shifted by the spread of a device
spread     one spread from device to device is twice that of the file
pattern    one coordinate has a bow of the spread of a device from centre to edge

A night has one lot of 3 wafers; 4 earlier nights are drawn from the file.  All laws are in full (``populations.draw``), while the
model under test is linear.  A kind is "none-60": what, and how many devices.

    DIR/KIND.jsonl    one JSON object per row; an interrupted study continues there
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.learning.lot.gyro import COORDINATES
from pipeline.learning.lot.measured import MeasuredLot
from pipeline.learning.lot.origin import drift, origin
from pipeline.learning.lot.origin_answers import DepartureAnswer
from populations.draw import draw
from populations.spec import PopulationSpec, load_spec

from ..lots.population import population_at
from .coverage import Share
from .hidden_lots import IN, measured_lot
from .rows_by_kind import add_rows

SIZES = (30, 60, 200)
KINDS = tuple(f"{what}-{size}" for size in SIZES for what in ("none", "mean", "spread", "pattern"))
EARLIER, WAFERS, FALSE_ALARM = 4, 3, 0.01
#: Parameters of a spread from device to device that are doubled together.
SPREADS = (
    ("spring_mismatch.die_pct",),
    ("residual_anisotropy.die_pct",),
    ("electrode_area.die_pct", "electrode_gap.die_pct"),
    ("damping_anisotropy.die",),
    ("damping.die", "lid_pressure.spread"),
)
_STREAM = 151


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of ``item`` = (kind, number), computed on a worker."""
    kind, number = item
    started = time.process_time()
    what, _, size = kind.partition("-")
    spec = load_spec(None)
    nights = [_night(spec, seed, kind, number, k, int(size)) for k in range(1, EARLIER + 1)]
    changed, coordinate = spec, list(IN)[number % len(IN)]
    if what == "spread":
        names = SPREADS[number % len(SPREADS)]
        changed = spec.with_values({name: 2.0 * _value(spec, name) for name in names})
    tonight = _night(changed, seed, kind, number, 0, int(size))
    if what in ("mean", "pattern"):
        shape = np.ones(len(tonight.device)) if what == "mean" else tonight.x**2 + tonight.y**2
        values = tonight.values.copy()
        values[:, COORDINATES.index(coordinate)] += IN[coordinate] * shape
        tonight = replace(tonight, values=values)
    whole = _together([tonight, *nights])
    mine = np.arange(len(whole.device)) < len(tonight.device)
    with threadpool_limits(limits=1):
        come = origin(tonight, population_at(spec, tonight), FALSE_ALARM, number)
        moved = drift(whole, mine, population_at(spec, whole), tuple("abcd"), FALSE_ALARM, number)
    return {
        "kind": kind,
        "number": number,
        "seed": seed,
        "origin": {
            "p": come.p_value,
            "found": bool(come.departures),
            "named": _named(what, coordinate, come.departures),
        },
        "drift": {
            "p": moved.p_value,
            "found": bool(moved.departures),
            "named": _named(what, coordinate, moved.departures),
        },
        "first": [one.part for one in (*come.departures[:1], *moved.departures[:1])],
        "cpu_seconds": time.process_time() - started,
    }


def _value(spec: PopulationSpec, name: str) -> float:
    irregularity, _, parameter = name.partition(".")
    return spec.irregularity[irregularity][parameter]


def _named(what: str, coordinate: str, found: Sequence[DepartureAnswer]) -> bool:
    """Whether the least probable departure is of the right kind, and of the right coordinate where there is one."""
    if not found:
        return False
    first = found[0]
    if what == "spread":
        return first.kind == "spread" and first.level == "device"
    return first.quantity == coordinate and (first.kind == "mean") == (what == "mean")


def _night(spec: PopulationSpec, seed: int, kind: str, number: int, k: int, devices: int) -> MeasuredLot:
    wafer = msgspec.structs.replace(spec.wafer, lots_per_batch=1, wafers_per_lot=WAFERS)
    stream = np.random.SeedSequence(seed, spawn_key=(_STREAM, KINDS.index(kind), number, k))
    own, other = stream.generate_state(2)
    made = draw(msgspec.structs.replace(spec, wafer=wafer), int(own), 0, devices)
    lot = measured_lot(f"night {k}", made, spec, np.random.default_rng(int(other)))
    # Nights repeat the names of their lots and devices.
    labels = {**lot.labels, "lot": (f"lot {k}",) * devices}
    return replace(lot, labels=labels, device=tuple(f"{k}-{name}" for name in lot.device))


def _together(lots: Sequence[MeasuredLot]) -> MeasuredLot:
    return replace(
        lots[0],
        values=np.concatenate([lot.values for lot in lots]),
        covariance=np.concatenate([lot.covariance for lot in lots]),
        labels={level: tuple(name for lot in lots for name in lot.labels[level]) for level in lots[0].labels},
        x_mm=np.concatenate([lot.x_mm for lot in lots]),
        y_mm=np.concatenate([lot.y_mm for lot in lots]),
        time=np.concatenate([lot.time for lot in lots]),
        device=tuple(name for lot in lots for name in lot.device),
    )


def run_study(kinds: Sequence[str], count: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the files in ``folder``; yields (done, total); UsageError for an unknown kind."""
    return add_rows(study_row, KINDS, kinds, count, seed, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Share]:
    """Shares of rows whose question is answered by "departs" or "drifted", and with the right kind and coordinate first."""
    found: dict[str, Share] = {}
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind]
        for question in ("origin", "drift") if own else ():
            alarms = sum(row[question]["found"] for row in own)
            found[f"{kind}, {question}: {'false alarms' if kind.startswith('none') else 'found'}"] = Share(
                alarms, len(own)
            )
            if not kind.startswith("none"):
                named = sum(row[question]["named"] for row in own)
                found[f"{kind}, {question}: named"] = Share(named, alarms)
    return found
