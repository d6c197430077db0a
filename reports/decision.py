"""The decision: posterior draws against limits.

    P(conform) = share of the draws that meet all limits together
    pass, fail or undecided by the rule (``reports.rules``): from P(conform), or from median and sd of each quantity
    undecided whenever the identification status is not "ok"

Shapes: B devices, n draws each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import UsageError
from pipeline.inference.estimate import intervals

from .acceptance import by_estimates
from .limits import Limits

Verdict = Literal["pass", "fail", "undecided"]
VERDICTS: tuple[Verdict, ...] = ("pass", "fail", "undecided")


@dataclass(frozen=True, eq=False)
class Decisions:
    """Decisions about B devices.

    Parameters
    ----------
    p_pass : (B,) posterior probability of conformity; nan where it is unknown.
    verdict : B times "pass", "fail" or "undecided".
    failed_limits : B comma-separated lists of the quantities whose own probability of conformity is at most one half, the least
        probable first; by a rule by estimate: whose estimate is outside, by the most standard uncertainties first.
    """

    p_pass: FloatArray
    verdict: tuple[Verdict, ...]
    failed_limits: tuple[str, ...]


def conforms_each(limits: Limits, values: Mapping[str, FloatArray]) -> dict[str, BoolArray]:
    """Whether each limit is met: quantity -> (...) like its values; nan never conforms.

    Raises
    ------
    UsageError : a limited quantity has no values.
    """
    missing = [name for name in limits.quantities if name not in values]
    if missing:
        raise UsageError(
            "no values of a limited quantity",
            value=missing,
            allowed=", ".join(sorted(values)),
            next_step="give its values (nan where unknown) or drop the limit",
        )
    return {limit.quantity: limit.admits(np.asarray(values[limit.quantity])) for limit in limits.limits}


def conforms(limits: Limits, values: Mapping[str, FloatArray]) -> BoolArray:
    """Whether all limits are met together: (...) like the values; nan never conforms.

    Raises
    ------
    UsageError : a limited quantity has no values.
    """
    return np.asarray(np.logical_and.reduce(list(conforms_each(limits, values).values())))


@dataclass(frozen=True, eq=False)
class Conformity:
    """Conformity of B devices by their draws.

    Parameters
    ----------
    surely, maybe : (B,) share of the draws that certainly and that possibly meet all limits; they differ where draws are nan.
    own : (L, B) share of the draws that possibly meet each limit.
    """

    surely: FloatArray
    maybe: FloatArray
    own: FloatArray

    @property
    def p_pass(self) -> FloatArray:
        """(B,) P(conform); nan where it is not known."""
        return np.where(self.surely == self.maybe, self.surely, np.nan)


def conformity(limits: Limits, draws: Mapping[str, FloatArray]) -> Conformity:
    """Shares of the draws that meet the limits, for draws as of :func:`decide`; raises as :func:`conforms_each`."""
    each = conforms_each(limits, draws)
    unknown = {name: np.isnan(draws[name]) for name in each}
    possible = {name: met | unknown[name] for name, met in each.items()}
    return Conformity(
        _shares(np.logical_and.reduce(list(each.values()))),
        _shares(np.logical_and.reduce(list(possible.values()))),
        np.array([_shares(met) for met in possible.values()]),
    )


def _shares(met: BoolArray) -> FloatArray:
    """Share (B,) of the draws (B, n) that are met: counted, which takes a fifth of the time of a mean."""
    return np.array([np.count_nonzero(row) for row in met]) / met.shape[1]


def decide(limits: Limits, draws: Mapping[str, FloatArray], status: Sequence[str]) -> Decisions:
    """P(conform) = mean over draws of all limits met, and the verdict of the rule.

    A draw that is nan in a limited quantity may or may not conform.  P(conform) then lies between the
    share of draws that certainly conform and the share that possibly conform.  The verdict is given if both
    bounds agree on it, and p_pass is nan if they differ.

    Parameters
    ----------
    limits : limits and rule.
    draws : quantity -> (B, n) posterior draws in the units of the results columns; every limited quantity;
        (B, 1) for a quantity that is known exactly or unknown (nan).
    status : B statuses; only devices with status "ok" are judged.

    Raises
    ------
    UsageError : a limited quantity has no draws, or the shapes do not agree.
    """
    values = _one_shape(limits, draws, len(status))
    found = conformity(limits, values)
    judged = np.array([one == "ok" for one in status], dtype=np.bool_)
    if limits.rule.by_estimate:
        known = by_estimates(limits.rule, limits.limits, *_estimates(values))
        passes, fails, rank = known.passes, known.fails, -np.array(list(known.outside.values()))
    else:
        passes, fails = found.surely >= limits.rule.pass_at, found.maybe <= limits.rule.fail_at
        rank = np.where(found.own <= 0.5, found.own - 1.0, 0.0)
    verdict = tuple(_verdict(bool(p), bool(f)) for p, f in zip(judged & passes, judged & fails, strict=True))
    failed = tuple(failed_cell(limits.quantities, rank[:, b]) if judged[b] else "" for b in range(len(status)))
    return Decisions(np.where(judged, found.p_pass, np.nan), verdict, failed)


def _estimates(values: Mapping[str, FloatArray]) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Estimate and standard uncertainty (B,) of each quantity, as in the columns <q> and <q>_sd; nan where unknown."""
    rows = len(next(iter(values.values())))
    found = [intervals({name: draws[b] for name, draws in values.items()}) for b in range(rows)]
    estimate, u = (
        {name: np.array([row.get(f"{name}{end}", np.nan) for row in found]) for name in values} for end in ("", "_sd")
    )
    return estimate, u


def _verdict(passes: bool, fails: bool) -> Verdict:
    if passes:
        return "pass"
    return "fail" if fails else "undecided"


def failed_cell(names: Sequence[str], rank: FloatArray) -> str:
    """The names whose ``rank`` (L,) is negative, the lowest first, separated by commas."""
    return ",".join(names[k] for k in np.argsort(rank, kind="stable") if rank[k] < 0.0)


def _one_shape(limits: Limits, draws: Mapping[str, FloatArray], devices: int) -> dict[str, FloatArray]:
    """The draws of the limited quantities; single draws are repeated."""
    values = {name: np.asarray(draws[name], dtype=np.float64) for name in limits.quantities if name in draws}
    shapes = {name: array.shape for name, array in values.items()}
    n = max((shape[-1] for shape in shapes.values() if shape), default=1)
    if any(shape not in ((devices, n), (devices, 1)) for shape in shapes.values()) or n == 0:
        raise UsageError(
            "the draws have different shapes",
            value=shapes,
            allowed=f"({devices}, n) for every limited quantity, n >= 1, one row a status",
            next_step="stack the draws of each device as a row",
        )
    return {name: np.broadcast_to(array, (devices, n)) for name, array in values.items()}
