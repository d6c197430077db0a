"""The decision: posterior draws against limits.

    P(conform) = share of the draws that meet all limits together
    pass      P(conform) >= pass_at
    fail      P(conform) <= fail_at
    undecided in between, and whenever the identification status is not "ok"

Shapes: B devices, n draws each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from pipeline.errors import UsageError

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
    failed_limits : B comma-separated lists of the quantities whose own probability of conformity is at most
        one half, the least probable first; empty if there is none.
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
    each = conforms_each(limits, values)
    unknown = {name: np.isnan(values[name]) for name in each}
    surely = np.logical_and.reduce(list(each.values())).mean(axis=1)
    maybe = np.logical_and.reduce([met | unknown[name] for name, met in each.items()]).mean(axis=1)
    own = np.array([(met | unknown[name]).mean(axis=1) for name, met in each.items()])

    judged = np.array([one == "ok" for one in status], dtype=np.bool_)
    p_pass = np.where(judged & (surely == maybe), surely, np.nan)
    passes = judged & (surely >= limits.rule.pass_at)
    fails = judged & (maybe <= limits.rule.fail_at)
    verdict = tuple(_verdict(bool(p), bool(f)) for p, f in zip(passes, fails, strict=True))
    names = tuple(each)
    failed = tuple(_failed(names, own[:, b]) if judged[b] else "" for b in range(len(status)))
    return Decisions(p_pass, verdict, failed)


def _verdict(passes: bool, fails: bool) -> Verdict:
    if passes:
        return "pass"
    return "fail" if fails else "undecided"


def _failed(names: tuple[str, ...], probability: FloatArray) -> str:
    order = np.argsort(probability, kind="stable")
    return ",".join(names[k] for k in order if probability[k] <= 0.5)


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
