"""How often the loop is right: hidden terms, found or not, with Clopper-Pearson intervals.

right     named exactly what was hidden, or nothing where nothing was
class     named classes of at most three members, each holding what was hidden, and nothing else
wide      the same with a larger class
wrong     named something else
unknown, adequate, fit_failed   the verdicts that name nothing (adequate where something was hidden)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from scipy.stats import binomtest

from .examine import Rules
from .loop import Diagnosis, diagnose
from .problem import Problem

Outcome = Literal["right", "class", "wide", "wrong", "unknown", "adequate", "fit_failed"]
_MEMBERS = 3


@dataclass(frozen=True)
class Share:
    """``count`` of ``total`` with its two-sided 95 % Clopper-Pearson interval."""

    count: int
    total: int
    low: float
    high: float


def share(count: int, total: int) -> Share:
    """count / total with its interval; (0, 1) where nothing was tried."""
    if total == 0:
        return Share(0, 0, 0.0, 1.0)
    interval = binomtest(count, total).proportion_ci(0.95, method="exact")
    return Share(count, total, float(interval.low), float(interval.high))


def judge(diagnosis: Diagnosis, hidden: tuple[str, ...]) -> Outcome:
    """The outcome of one diagnosis when the hidden terms are known."""
    if diagnosis.verdict == "fit_failed":
        return "fit_failed"
    if diagnosis.verdict == "unknown":
        return "unknown"
    if diagnosis.verdict == "adequate":
        return "adequate" if hidden else "right"
    if set(diagnosis.terms) == set(hidden) and diagnosis.verdict == "effect":
        return "right"
    small = all(len(item.members) <= _MEMBERS for item in diagnosis.classes)
    if len(diagnosis.classes) == len(hidden):
        rest = set(hidden)
        for item in diagnosis.classes:
            rest -= set(item.members)
        if not rest:
            return "class" if small else "wide"
    return "wrong"


def rates(
    make: Callable[[int], tuple[Problem, tuple[str, ...]]], seeds: Iterable[int], rules: Rules | None = None
) -> dict[Outcome, Share]:
    """Diagnose many problems.

    Parameters
    ----------
    make : seed -> problem and the names of the terms hidden in it.
    seeds : one problem each.
    rules : of the loop.
    """
    counts: Counter[Outcome] = Counter()
    for seed in seeds:
        problem, hidden = make(seed)
        counts[judge(diagnose(problem, rules=rules), hidden)] += 1
    total = counts.total()
    outcomes: tuple[Outcome, ...] = ("right", "class", "wide", "wrong", "unknown", "adequate", "fit_failed")
    return {outcome: share(counts[outcome], total) for outcome in outcomes}
