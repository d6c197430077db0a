"""Study of rare losses: are the estimates unbiased, and do their intervals hold?

Each kind is a limit state: closed forms with a known loss, and limits of the default population, whose loss is known exactly for
the sense imbalance and by plain Monte Carlo for the others.  A row is one estimate with its own random numbers.  The kind
"plain" has the devices beyond each limit of the population among ``PLAIN_DEVICES`` of plain Monte Carlo.

    DIR/<kind>.jsonl    one JSON object per row; an interrupted study continues there

A row depends on (seed, kind, number) only.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from reports.limits import Limit
from reports.rare import Loss

from ..rare.estimate import rare_losses
from ..rare.losses import limit_states
from .coverage import Share
from .limit_states import POPULATION, closed_forms, imbalance_loss, population_config
from .rows_by_kind import add_rows, processor_times

PLAIN = "plain"
KINDS = (*closed_forms(), *POPULATION, PLAIN)
#: Devices of an estimate, as the default of [sampling].
DEVICES, PRECISION = 20_000, 0.2
#: Plain devices of a row: two seconds.
PLAIN_DEVICES = 100_000
_STREAM = 132


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of ``item`` = (kind, number), computed on a worker."""
    kind, number = item
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, crc32(kind.encode()), number)))
    started = time.process_time()
    row: dict[str, Any] = {"kind": kind, "number": number, "seed": seed}
    if kind == PLAIN:
        row |= {"lost": _plain(seed, random), "devices": PLAIN_DEVICES}
    else:
        row |= _estimated(kind, seed, random)
    return row | {"cpu_seconds": time.process_time() - started}


def _estimated(kind: str, seed: int, random: np.random.Generator) -> dict[str, Any]:
    closed = closed_forms().get(kind)
    problem = limit_states(population_config(kind, seed, DEVICES)).problem if closed is None else closed.problem
    return _plain_loss(rare_losses(problem, DEVICES, PRECISION, random).losses[0])


def _plain_loss(loss: Loss) -> dict[str, Any]:
    return {
        "probability": loss.probability,
        "low": loss.low,
        "high": loss.high,
        "relative_sd": loss.relative_sd,
        "ess": loss.ess,
        "undecided": loss.undecided.reason if loss.undecided else "",
    }


def _plain(seed: int, random: np.random.Generator) -> dict[str, int]:
    """Devices beyond each limit of the population, the same devices for all of them."""
    from populations.latent import draw_latent, latent_space

    from ..screening.block import true_quantities
    from ..screening.settings import population

    config = population_config(next(iter(POPULATION)), seed, DEVICES)
    spec = population(config)
    space = latent_space(spec)
    drawn = draw_latent(spec, space, random.standard_normal((PLAIN_DEVICES, space.dimension)), seed)
    values = true_quantities(config, drawn.true, spec.angular_gain)
    out = {}
    for name, (quantity, ends) in POPULATION.items():
        low = -math.inf if ends.min is None else ends.min
        high = math.inf if ends.max is None else ends.max
        out[name] = int(np.count_nonzero(~Limit(quantity, low, high).admits(values[quantity])))
    return out


def run_study(kinds: Sequence[str], count: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the files in ``folder``; yields (done, total).

    Raises
    ------
    UsageError : an unknown kind, or the folder cannot be written.
    """
    return add_rows(study_row, KINDS, kinds, count, seed, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Bias, spread, coverage and share of decided estimates of each kind, and of all closed forms together."""
    plain = [row for row in rows if row["kind"] == PLAIN]
    found: dict[str, Any] = {}
    scores: list[np.ndarray[Any, np.dtype[np.float64]]] = []
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind]
        if kind == PLAIN or len(own) < 2:
            continue
        exact, relative_sd = _reference(kind, plain)
        estimate = np.array([row["probability"] for row in own])
        mean, sd = float(np.mean(estimate)), float(np.std(estimate, ddof=1))
        error = sd / math.sqrt(len(own))
        found[f"{kind}: mean estimate"] = f"{mean:.4g} +- {error:.2g}"
        found[f"{kind}: sd of an estimate, relative"] = f"{sd / mean:.3f}"
        if not math.isnan(exact):
            apart = math.hypot(error, exact * relative_sd)
            found[f"{kind}: exact or plain"] = f"{exact:.4g}" + (
                f" +- {exact * relative_sd:.2g}" if relative_sd else ""
            )
            found[f"{kind}: bias over sd"] = _with_interval((mean - exact) / sd, apart / sd)
        # Plain Monte Carlo that is less precise than this cannot judge single estimates; their own mean can.
        known = exact if relative_sd <= 0.1 * PRECISION else mean
        held = sum(row["low"] <= known <= row["high"] for row in own)
        found[f"{kind}: interval holds"] = Share(held, len(own))
        decided = [row for row in own if not row["undecided"]]
        found[f"{kind}: decided"] = Share(len(decided), len(own))
        near = sum(abs(row["probability"] / known - 1.0) <= PRECISION for row in decided)
        found[f"{kind}: decided ones within 20 %"] = Share(near, len(decided))
        if relative_sd == 0.0:
            scores.append((estimate - exact) / sd)
    if scores:
        all_scores = np.concatenate(scores)
        found["all with an exact loss: bias over sd"] = _with_interval(
            float(np.mean(all_scores)), float(np.std(all_scores)) / math.sqrt(all_scores.size)
        )
    return found | processor_times([row for row in rows if row["kind"] != PLAIN])


def _with_interval(value: float, sd: float) -> str:
    return f"{value:+.3f} ({value - 1.96 * sd:+.3f} to {value + 1.96 * sd:+.3f})"


def _reference(kind: str, plain: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """The loss of a kind and its relative sd; nan where plain Monte Carlo has not seen it."""
    closed = closed_forms().get(kind)
    exact = imbalance_loss(kind) if closed is None else closed.probability
    if exact is not None:
        return exact, 0.0
    lost = sum(row["lost"][kind] for row in plain)
    return (lost / sum(row["devices"] for row in plain), 1.0 / math.sqrt(lost)) if lost else (math.nan, math.nan)
