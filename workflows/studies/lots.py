"""How often the loop for a lot is right about the lots of ``hidden_lots``.

none        nothing is hidden: a name is a false alarm
one, two    irregularities of the library are hidden, each with an SNR of 10 to 100
left-out    a generic irregularity is hidden, and its file and those of its twins are taken out of the library: unknown is right
outside     a pattern of no library is hidden: unknown is right

The SNR of what is hidden is the root of the deviance by which its own part improves the refitted baseline.  A random pattern has
a random part, so that what a spread of the population absorbs does not count.  The seed chooses the irregularity (all in turn)
and the SNR that its size is scaled to, log-uniform in ``SNR``.  A pattern that cannot reach 10 in one quantity is
hidden in the next.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pipeline.errors import ConfigError
from pipeline.learning.lot.diagnosis import candidates_of, kind_of, mixtures_of
from pipeline.learning.lot.loop import deviance, first_rung, with_part
from pipeline.learning.lot.model import RandomPart
from pipeline.learning.lot.population import DeviceMixture, Part
from pipeline.learning.lot.prepared import prepared
from pipeline.learning.lot.table import LotTable

from ..lots.loop import lot_answers
from ..lots.population import population_at
from .hidden_lots import IN, KINDS, PHYSICAL, HiddenLot, LotKind, hidden_lot

SNR = (10.0, 100.0)
#: Trials of a size, and the factor between the SNR that is wanted and the one that will do.
SIZINGS, NEAR = 7, 1.4


def snr_of(hidden: HiddenLot) -> tuple[float, ...]:
    """SNR of each hidden irregularity, in the order of ``truth``."""
    ready = prepared(hidden.lot, population_at(hidden.spec, hidden.lot))
    base = first_rung(ready)
    parts = (*candidates_of(ready, base.model), *mixtures_of(ready))
    found = []
    for name in hidden.truth:
        own: list[Part | DeviceMixture] = [part for part in parts if part.name == name and isinstance(part, RandomPart)]
        if name in PHYSICAL:
            own = [part for part in parts if kind_of(part.name) == name]
        falls = [deviance(base) - deviance(with_part(base, part)) for part in own or [hidden.patterns[name]]]
        found.append(float(np.sqrt(max(0.0, *falls))) if falls else 0.0)
    return tuple(found)


def judged(kind: LotKind, seed: int) -> dict[str, Any]:
    """One row of the study: what was hidden, what was found, whether that is right."""
    start = time.process_time()
    hidden, snr = sized(kind, seed)
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
        "snr": list(snr),
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


def sized(kind: LotKind, seed: int) -> tuple[HiddenLot, tuple[float, ...]]:
    """A lot whose hidden parts are near the SNR that the seed asks for, and their SNR."""
    hidden = hidden_lot(kind, seed)
    if kind == "none":
        return hidden, ()
    g = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, KINDS.index(kind), 1])))
    wanted = SNR[0] * (SNR[1] / SNR[0]) ** g.random(len(hidden.truth))
    best: tuple[float, HiddenLot, tuple[float, ...]] | None = None
    for turn in range(len(IN)):
        sizes = np.ones(len(hidden.truth))
        for _ in range(SIZINGS):
            try:
                hidden = hidden_lot(kind, seed, tuple(sizes.tolist()), turn)
            except ConfigError:  # so large that a device has no stiffness left
                sizes = 0.5 * sizes
                continue
            snr = np.array(snr_of(hidden))
            off = float(np.max(np.abs(np.log(np.maximum(snr, 1e-3) / wanted))))
            if best is None or off < best[0]:
                best = off, hidden, tuple(snr.tolist())
            if off < np.log(NEAR) and np.all(snr >= SNR[0]):
                return hidden, tuple(snr.tolist())
            sizes = sizes * np.clip(wanted / np.maximum(snr, 1e-3), 0.3, 3.0)
        if not hidden.patterns or (best is not None and min(best[2]) >= SNR[0]):
            break
    assert best is not None
    return best[1], best[2]


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
