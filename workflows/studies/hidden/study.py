"""Run the study: hide effects, diagnose, refine, and write one line per campaign; an interrupted study can be resumed.

    DIR/<kind>.jsonl    one JSON object per campaign, in the order in which the campaigns finish

Except for its times, a row depends on (seed, kind, number) only.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from errno import EACCES
from pathlib import Path
from typing import Any, TypeVar

import dask
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import Ladder, as_diagnosis, as_ladder
from pipeline.criticism.problem import Problem
from pipeline.criticism.verdict import TermClass
from pipeline.errors import GyroscreenError, UsageError, unwritable
from pipeline.inference.general.fit import CampaignFit
from pipeline.learning.campaign.answers import campaign_answers
from pipeline.learning.campaign.problem import CampaignProblem

from ...learning import DiagnosisResult, RefinementResult
from ...process import worker_count
from ...screening.cluster import cluster
from ...screening.dispatch import in_parallel
from . import strengths
from .draw import SIGMA_V, Hidden, hide
from .kinds import KINDS
from .restricted import RestrictedProblem

#: Kinds of campaigns that are also refined.
_REFINED = ("one", "two", "outside", "left-out", "bench-one", "bench-foreign", "lone-one", "lone-foreign")
_CANDIDATES = 5
#: Memory of a worker.  One campaign takes 1.1 GB (bench-one 13, seed 2039); at the 2 GiB of a night, workers were replaced within
#: their second campaign, and some campaigns began again until they were given up.
_WORKER_BYTES = 4 * 2**30
_Found = TypeVar("_Found")
#: A campaign with the signatures of all candidates is larger than a screening block; dask must not kill a worker for that.
_MEMORY = {f"distributed.worker.memory.{what}": False for what in ("target", "spill", "pause", "terminate")}


@dataclass(frozen=True)
class StudyPlan:
    """The campaigns of a study: the numbers of each kind, and the root of all random streams."""

    seed: int
    numbers: Mapping[str, tuple[int, ...]]


def study_plan(kind: str, campaigns: int | None, seed: int, only: int | None = None) -> StudyPlan:
    """Plan ``campaigns`` campaigns (by default those of the whole study) of a kind or of "all", or ``only`` one.

    Raises
    ------
    UsageError : an unknown kind, or an invalid number of campaigns.
    """
    groups = {name: "bench" if one.bench else "lone" if one.lone else name for name, one in KINDS.items()}
    kinds = tuple(name for name, group in groups.items() if kind in ("all", name, group))
    if not kinds:
        raise UsageError(
            "no such kind of hidden campaigns", value=kind, allowed=f"all, bench, lone, {', '.join(KINDS)}"
        )
    if campaigns is not None and campaigns < 1:
        raise UsageError("no campaigns to study", value=campaigns, allowed="1 or more")
    if only is not None and (kind not in KINDS or only < 0):
        raise UsageError("one campaign needs its kind and its number", value=only, next_step="--kind one --only 3")
    if only is not None:
        return StudyPlan(seed, {kind: (only,)})
    return StudyPlan(seed, {k: tuple(range(campaigns or KINDS[k].campaigns)) for k in kinds})


def examine(hidden: Hidden) -> dict[str, Any]:
    """Run the loop on a campaign and return its row.

    ``sizes`` are the hidden parameters that are zero without their effect; ``truth`` are all others and the split.  A step that
    was not run is ``None``; ``failed`` gives the reason if the campaign could not be run.
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
        row |= run_loop(hidden)
    except (GyroscreenError, ArithmeticError, ValueError) as error:
        # One campaign that cannot be run must not end the study.
        row["failed"] = f"{type(error).__name__}: {error}"
    return row


def run_loop(hidden: Hidden) -> dict[str, Any]:
    """One forward selection, reported as a diagnosis and, for the kinds that are refined, also as a ladder.

    Both include the time of the selection.
    """
    answers = campaign_answers(hidden.campaign, hidden.model, threads=1)

    def restricted(problem: CampaignProblem) -> Problem:
        return RestrictedProblem(problem, hidden.left_out) if hidden.left_out else problem

    (answers, selection), shared = _timed(lambda: answers.selected(Rules(), restricted))
    problem = restricted(answers.problem)
    diagnosis, own = _timed(lambda: as_diagnosis(problem, selection))
    row = {"diagnose": {**_diagnosed(DiagnosisResult(answers, diagnosis).to_dict()), **_sum(shared, own)}}
    if hidden.kind in _REFINED:
        ladder, own = _timed(lambda: as_ladder(problem, selection))
        row["refine"] = {**_refined(RefinementResult(answers, ladder).to_dict()), **_sum(shared, own)}
        if ladder.selection.tests and hidden.noise_free_v:
            row["refine"]["snr_left"] = snr_left(answers.problem.campaign_fit(ladder.selection.last.fit.terms), hidden)
        elif ladder.selection.tests and set(hidden.effects) <= set(hidden.left_out):
            row["refine"]["snr_left"] = snr_beside(answers.problem, ladder, hidden)
        row["refine"]["class_delta_chi2"] = [_largest_rise(problem, ladder, one) for one in ladder.classes]
    return row


def _largest_rise(problem: Problem, ladder: Ladder, one: TermClass) -> float | None:
    """Largest rise of chi2 where a member of a class takes the place of its selected term; ``None`` where a fit fails."""
    last = ladder.selection.last.fit
    swapped = [tuple(other if name == one.term else name for name in last.terms) for other in one.members[1:]]
    fits = [problem.fit(terms, last) for terms in swapped]
    return max([fit.chi2 - last.chi2 for fit in fits], default=0.0) if all(fit.ok for fit in fits) else None


def snr_left(fit: CampaignFit, hidden: Hidden) -> float:
    """SNR of what a fit does not reproduce of the noise-free fit records:  sqrt(max(|(f - y_free) / sigma|^2 - P, 0)).

    P parameters that follow the noise add P to the square.
    """
    left = strengths.row([r.predicted_v - hidden.noise_free_v[r.name] for r in fit.of_role("fit")])
    energy = float(left @ left) / SIGMA_V**2
    return float(np.sqrt(max(energy - fit.x.size, 0.0)))


def snr_beside(problem: CampaignProblem, ladder: Ladder, hidden: Hidden) -> float:
    """SNR by which the campaign itself prefers the hidden effects to the last model:  sqrt(max(chi2 - chi2 of their fit, 0)).

    For records that differ, of which there is no noise-free version; infinite where a fit fails.
    """
    last = ladder.selection.last.fit
    fit = problem.fit(tuple(hidden.effects), problem.fit(()))
    return float(np.sqrt(max(last.chi2 - fit.chi2, 0.0))) if fit.ok else float("inf")


def _timed(step: Callable[[], _Found]) -> tuple[_Found, dict[str, float]]:
    """The result of ``step``, its wall-clock time and its processor time [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    found = step()
    return found, {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}


def _sum(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: one[name] + other[name] for name in one}


def _diagnosed(found: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis with the best candidates only."""
    return {**found, "candidates": found["candidates"][:_CANDIDATES]}


def _refined(found: Mapping[str, Any]) -> dict[str, Any]:
    """A ladder with the parameters of the last rung only."""
    ladder = [{k: v for k, v in rung.items() if k != "parameters"} for rung in found["ladder"]]
    parameters = found["ladder"][-1]["parameters"] if found["ladder"] else {}
    return {**found, "ladder": ladder, "parameters": parameters}


def study_block(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of campaign ``item`` = (kind, number), computed on a worker."""
    with threadpool_limits(limits=1):
        return examine(hide(*item, seed))


def rows_in(folder: Path, kinds: Sequence[str], seed: int) -> list[dict[str, Any]]:
    """The finished rows of these kinds and this seed; a line that was cut off by an interruption is ignored."""
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
    """Append a row to the file of its kind, on a new line even if the last line was cut off by an interruption."""
    path = folder / f"{row['kind']}.jsonl"
    cut_off = path.exists() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write(("\n" if cut_off else "") + json.dumps(row, default=float) + "\n")


def make_folder(folder: Path) -> None:
    """Make the folder of the rows of a study.

    Raises
    ------
    UsageError : it cannot be made, or nothing can be written to it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(EACCES, os.strerror(EACCES))
    except OSError as error:
        raise unwritable("the folder for the rows", folder, error, "choose another --out") from None


def resumed(
    task: Callable[[int, tuple[str, int]], dict[str, Any]],
    seed: int,
    wanted: Sequence[tuple[str, int]],
    before: Collection[tuple[str, int]],
    folder: Path,
    workers: int,
) -> Iterator[tuple[int, int]]:
    """Append the rows ``task(seed, item)`` of the items (kind, number) that are ``wanted`` and were not done ``before``.

    Yields (rows done, rows wanted), including those done before, each time one finishes.
    """
    missing = [item for item in wanted if item not in before]
    done = len(wanted) - len(missing)
    yield done, len(wanted)
    if not missing:
        return
    with cluster(min(worker_count(workers), len(missing)), None, _WORKER_BYTES) as client:
        for row in in_parallel(client, task, seed, missing):
            append(folder, row)
            done += 1
            yield done, len(wanted)


def run_study(plan: StudyPlan, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Run the campaigns of ``plan`` that are missing in ``folder``; a campaign that failed to run is run again.

    Yields (campaigns done, campaigns planned), including those done before, each time a campaign finishes.
    """
    make_folder(folder)
    wanted = [(kind, number) for kind, numbers in plan.numbers.items() for number in numbers]
    before = {(r["kind"], r["number"]) for r in rows_in(folder, tuple(plan.numbers), plan.seed) if not r["failed"]}
    with dask.config.set(_MEMORY):
        yield from resumed(study_block, plan.seed, wanted, before, folder, workers)
