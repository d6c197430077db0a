"""The study: hide, diagnose, refine, write one line a campaign; an interrupted study goes on where it was.

    DIR/<kind>.jsonl    one JSON object a campaign, appended as they are done

A row depends on (seed, kind, number) alone, but for its times.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import dask
from threadpoolctl import threadpool_limits

from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import as_diagnosis, as_ladder
from pipeline.criticism.problem import Problem
from pipeline.criticism.selection import forward_selection
from pipeline.errors import GyroscreenError, UsageError

from ...learning import Diagnosed, Refined, view_of
from ...machine import worker_count
from ...screening.cluster import cluster, in_parallel
from .draw import KINDS, Hidden, hide
from .narrowed import Narrowed

#: Kinds whose campaigns are refined too.
_REFINED = ("one", "two", "outside", "left-out")
_CANDIDATES = 5
_Found = TypeVar("_Found")
#: A campaign with the signatures of all candidates is larger than a screening block; a worker is not to be killed for it.
_MEMORY = {f"distributed.worker.memory.{what}": False for what in ("target", "spill", "pause", "terminate")}


@dataclass(frozen=True)
class Order:
    """What is asked for: the numbers of each kind, and the root of all random streams."""

    seed: int
    numbers: Mapping[str, tuple[int, ...]]


def order_of(kind: str, campaigns: int | None, seed: int, only: int | None = None) -> Order:
    """``campaigns`` (as many as the proof asks for without it) of a kind or of "all"; or the ``only`` one.

    Raises
    ------
    UsageError : an unknown kind, or a number that makes no sense.
    """
    if kind != "all" and kind not in KINDS:
        raise UsageError("no such kind of hidden campaigns", value=kind, allowed=f"all, {', '.join(KINDS)}")
    if campaigns is not None and campaigns < 1:
        raise UsageError("no campaigns to study", value=campaigns, allowed="1 or more")
    if only is not None and (kind == "all" or only < 0):
        raise UsageError("one campaign needs its kind and its number", value=only, next_step="--kind one --only 3")
    kinds = tuple(KINDS) if kind == "all" else (kind,)
    if only is not None:
        return Order(seed, {kind: (only,)})
    return Order(seed, {k: tuple(range(campaigns or KINDS[k].campaigns)) for k in kinds})


def examine(hidden: Hidden) -> dict[str, Any]:
    """The row of a campaign.

    ``sizes`` are the hidden parameters that are zero without their effect, ``truth`` all others and the split.  A step
    that was not done is ``None``; ``failed`` says why a campaign could not be run.
    """
    values = dict(hidden.values)
    sizes = {n: v for n, v in values.items() if n in hidden.sizes}
    truth = {n: v for n, v in values.items() if n not in sizes}
    row: dict[str, Any] = {
        "kind": hidden.kind,
        "number": hidden.number,
        "seed": hidden.seed,
        "hidden": list(hidden.effects),
        "left_out": list(hidden.left_out),
        "snr": list(hidden.snr),
        "sizes": sizes,
        "truth": {**truth, "split_hz": values["f2_hz"] - values["f1_hz"]},
        "diagnose": None,
        "refine": None,
        "failed": "",
    }
    try:
        row |= told(hidden)
    except (GyroscreenError, ArithmeticError, ValueError) as error:
        # A study outlives a campaign that cannot be run, and shows it.
        row["failed"] = f"{type(error).__name__}: {error}"
    return row


def told(hidden: Hidden) -> dict[str, Any]:
    """One climb, told as a diagnosis and, where the kind is refined, as a ladder; each with the time it takes by itself.

    Where the climb is longer than a diagnosis makes it, its time stands for both: at least what the shorter one takes.
    """
    view = view_of(hidden.campaign, threads=1)
    problem: Problem = Narrowed(view, hidden.left_out) if hidden.left_out else view
    selection, begun = _timed(lambda: forward_selection(problem))
    short = selection
    if len(selection.steps) > Rules.max_named:
        short = forward_selection(problem, rules=Rules(rungs=Rules.max_named))
    diagnosis, own = _timed(lambda: as_diagnosis(problem, short))
    row = {"diagnose": {**_diagnosed(Diagnosed(view, diagnosis).to_dict()), **_sum(begun, own)}}
    if hidden.kind in _REFINED:
        ladder, own = _timed(lambda: as_ladder(problem, selection))
        row["refine"] = {**_refined(Refined(view, ladder, selection).to_dict()), **_sum(begun, own)}
    return row


def _timed(step: Callable[[], _Found]) -> tuple[_Found, dict[str, float]]:
    """What ``step`` gives, and the time that it took: of the wall, and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = step()
    return found, {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}


def _sum(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: one[name] + other[name] for name in one}


def _diagnosed(found: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis with its first few candidates only."""
    return {**found, "candidates": found["candidates"][:_CANDIDATES]}


def _refined(found: Mapping[str, Any]) -> dict[str, Any]:
    """A ladder with the parameters of its last rung only."""
    ladder = [{k: v for k, v in rung.items() if k != "parameters"} for rung in found["ladder"]]
    parameters = found["ladder"][-1]["parameters"] if found["ladder"] else {}
    return {**found, "ladder": ladder, "parameters": parameters}


def study_block(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of one campaign, on a worker."""
    with threadpool_limits(limits=1):
        return examine(hide(*item, seed))


def rows_in(folder: Path, kinds: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """The finished rows of these kinds and this seed; a line that an interruption tore is no row."""
    rows: dict[tuple[str, int], dict[str, Any]] = {}
    for kind in kinds:
        path = folder / f"{kind}.jsonl"
        if not path.exists():
            continue
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:
                continue
            if row["seed"] == seed:
                rows[kind, row["number"]] = row
    return [rows[key] for key in sorted(rows)]


def append(folder: Path, row: Mapping[str, Any]) -> None:
    """One more line in the file of its kind; what an interruption tore is left on a line of its own."""
    path = folder / f"{row['kind']}.jsonl"
    torn = path.exists() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write(("\n" if torn else "") + json.dumps(row, default=float) + "\n")


def run_study(order: Order, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Run what is missing in ``folder``; yields (done, asked) as campaigns finish, those from before counted.

    A campaign that failed to run is run again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [(kind, number) for kind, numbers in order.numbers.items() for number in numbers]
    before = {(r["kind"], r["number"]) for r in rows_in(folder, tuple(order.numbers), order.seed) if not r["failed"]}
    missing = [item for item in wanted if item not in before]
    done = len(wanted) - len(missing)
    yield done, len(wanted)
    if not missing:
        return
    with dask.config.set(_MEMORY), cluster(min(worker_count(workers), len(missing)), None) as client:
        for row in in_parallel(client, study_block, order.seed, missing):
            append(folder, row)
            done += 1
            yield done, len(wanted)
