"""Probabilities of rare losses: subset simulation finds the regions, importance sampling estimates.

    1. search      subset simulation towards each limit, and slopes at lost devices             at most half of the devices
    2. improve     four batches from the mixture fitted to what was found, fitted again after each    a quarter of them
    3. estimate    an independent batch z_i ~ q                                                       all others

    p = 1/N sum_i w_i [z_i is lost],   w = N(z; 0, I) / q(z),   var p = 1/N (mean of (w [lost])^2 - p^2)

The proposal q of step 3 does not depend on its batch, so p is unbiased whatever steps 1 and 2 found.  One batch estimates all
limits and their union.  A region of loss that step 1 missed would be sampled by the nominal tenth of q alone; the estimate is
therefore compared with that of the subset simulation, and is undecided where they disagree.

Shapes: B devices, d latent normals, S sides of limits (a limit has a side for each of its ends).
Source: Au, Beck, Structural Safety 25 (2003) 139 (importance sampling from subset samples); Owen, Zhou, JASA 95 (2000) 135.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import BoolArray, FloatArray
from reports.rare import Loss, Undecided, loss_of

from .directions import fitted_directions, gradients
from .proposal import Mixture, defensive, fitted
from .subset import FLOOR, SHARE, Response, Subset, search

#: z (B, d) -> g (B, S): a device is beyond side s of a limit where g[:, s] > 0.
Responses = Callable[[FloatArray], FloatArray]

_SEARCH, _SLOPES, _IMPROVE, _ROUNDS = 0.45, 0.05, 0.25, 4
#: Fewest independent lost devices to which a part is fitted.
_FEWEST = 20
#: Levels of a search that reaches ``FLOOR``, and one more for the devices beyond the limit.
_LEVELS = 1 + round(math.log(FLOOR) / math.log(SHARE))
#: Fewest devices of a level: twenty chains of ten devices.
_LEAST_LEVEL = 200
#: The estimates of both methods disagree if they differ by more than this many sds of their ratio.
_DISAGREE = 4.0


@dataclass(frozen=True)
class LimitProblem:
    """Limits on devices with ``dimension`` latent normals; ``sides`` gives the columns of the responses for each limit."""

    dimension: int
    responses: Responses
    sides: Mapping[str, tuple[int, ...]]

    @property
    def count(self) -> int:
        """S."""
        return sum(len(columns) for columns in self.sides.values())


@dataclass(frozen=True, eq=False)
class Losses:
    """Loss to each limit and to any of them ("total"), the devices that were computed, and the batch behind the losses.

    ``z`` (N, d) with ``weight`` (N,) and ``beyond`` (N, S): a lost device of the population is one of the lost ones of these with
    probability proportional to its weight.
    """

    losses: tuple[Loss, ...]
    devices: int
    z: FloatArray
    weight: FloatArray
    beyond: BoolArray


def least_devices(sides: int) -> int:
    """Fewest devices with which :func:`rare_losses` can search for ``sides`` sides: two levels of each."""
    return round(2 * _LEAST_LEVEL * (sides + 1) / _SEARCH)


def rare_losses(problem: LimitProblem, devices: int, precision: float, random: np.random.Generator) -> Losses:
    """Loss to each limit from at most ``devices`` devices.

    ``precision`` is the half-width of the 95 % interval, relative to the loss, above which a loss is undecided.
    """
    level = max(int(_SEARCH * devices / (_LEVELS * problem.count + 1)), _LEAST_LEVEL)
    start = random.standard_normal((level, problem.dimension))
    first = problem.responses(start)
    most = int(_SEARCH * devices - level) // problem.count
    found = [search(_side(problem, s), start, first[:, s], most, random) for s in range(problem.count)]
    spent = level + sum(one.devices for one in found)

    points = int(_SLOPES * devices) // (problem.count * (problem.dimension + 1))
    slopes = {}
    for s, one in enumerate(found):
        chosen = random.permutation(len(one.lost))[:points]
        slopes[s] = gradients(_side(problem, s), one.lost[chosen]) if len(chosen) else np.empty((0, problem.dimension))
        spent += len(chosen) * (problem.dimension + 1)
    parts = {
        s: _fitted(one.lost, np.ones(len(one.lost)), one.independent, slopes[s], random)
        for s, one in enumerate(found)
        if len(one.lost)
    }
    batch = int(_IMPROVE * devices / _ROUNDS)
    known = dict.fromkeys(parts, _NOTHING)
    for _ in range(_ROUNDS):
        proposal = defensive(list(parts.values()), problem.dimension)
        z = proposal.drawn(batch, random)
        weight, g = proposal.weights(z), problem.responses(z)
        known = {s: _with_batch(known[s], z, weight, g[:, s] > 0.0) for s in parts}
        parts = {s: _refitted(part, known[s], slopes[s], random) for s, part in parts.items()}
    proposal = defensive(list(parts.values()), problem.dimension)
    z = proposal.drawn(devices - spent - batch * _ROUNDS, random)
    weight, beyond = proposal.weights(z), problem.responses(z) > 0.0
    losses = [_judged(name, weight, beyond, list(own), found, precision) for name, own in problem.sides.items()]
    losses.append(_judged("total", weight, beyond, list(range(problem.count)), found, precision))
    return Losses(tuple(losses), devices, z, weight, beyond)


def _side(problem: LimitProblem, s: int) -> Response:
    return lambda z: problem.responses(z)[:, s]


def plain_losses(problem: LimitProblem, devices: int, precision: float, random: np.random.Generator) -> Losses:
    """The same by plain Monte Carlo: all weights are one."""
    z = random.standard_normal((devices, problem.dimension))
    beyond, weight = problem.responses(z) > 0.0, np.ones(devices)
    named = {**problem.sides, "total": tuple(range(problem.count))}
    losses = tuple(
        loss_of(name, weight, np.any(beyond[:, list(own)], axis=1), precision, None) for name, own in named.items()
    )
    return Losses(losses, devices, z, weight, beyond)


def _fitted(
    z: FloatArray, weight: FloatArray, independent: float, slopes: FloatArray, random: np.random.Generator
) -> Mixture:
    directions = fitted_directions(z, weight / np.sum(weight), independent, slopes)
    return fitted(z, weight, independent, directions, random)


@dataclass(frozen=True, eq=False)
class _Known:
    """Lost devices of all batches so far: z, and weights that add up to the number of independent devices they are worth."""

    z: tuple[FloatArray, ...] = ()
    weight: tuple[FloatArray, ...] = ()


_NOTHING = _Known()


def _with_batch(known: _Known, z: FloatArray, weight: FloatArray, lost: BoolArray) -> _Known:
    """``known`` and the lost devices of a batch z (n, d) with weights (n,).

    The largest weights are clipped to the sqrt(n)-th of n, so that a few devices in the tail of a poor proposal do not
    determine the next one (Koblents, Miguez, Statistics and Computing 25 (2015) 407).
    """
    own, count = weight[lost], int(np.count_nonzero(lost))
    if not count:
        return known
    clip = math.isqrt(count)
    own = np.minimum(own, np.partition(own, -clip)[-clip])
    total = float(np.sum(own))
    return _Known((*known.z, z[lost]), (*known.weight, own * (total / float(np.sum(own**2)))))


def _refitted(part: Mixture, known: _Known, slopes: FloatArray, random: np.random.Generator) -> Mixture:
    """The part of a side, fitted again to the lost devices of all batches if they are enough."""
    weight = np.concatenate([np.empty(0), *known.weight])
    independent = float(np.sum(weight))
    return part if independent < _FEWEST else _fitted(np.concatenate(known.z), weight, independent, slopes, random)


def _judged(
    name: str, weight: FloatArray, beyond: BoolArray, sides: Sequence[int], found: Sequence[Subset], precision: float
) -> Loss:
    """The loss to a limit with these sides, undecided for what the searches say."""
    return loss_of(
        name, weight, np.any(beyond[:, list(sides)], axis=1), precision,
        _doubt(weight, beyond, sides, found, precision),
    )  # fmt: skip


def _doubt(
    weight: FloatArray, beyond: BoolArray, sides: Sequence[int], found: Sequence[Subset], precision: float
) -> Undecided | None:
    """Why the estimate may miss a region of loss: the estimate of the subset simulation is another one."""
    total = float(np.mean(weight * np.any(beyond[:, list(sides)], axis=1)))
    for s in sides:
        own = weight * beyond[:, s]
        estimate, one = float(np.mean(own)), found[s]
        if not len(one.lost):
            # Nothing was found beyond this side: it may be neglected where what was ruled out is small.
            if one.plateau:
                return Undecided("plateau", one.probability)
            if one.probability > precision * total:
                return Undecided("not_found", one.probability)
            continue
        # Only what would change the loss by its precision matters.
        relative = math.hypot(one.relative_sd, float(np.std(own)) / math.sqrt(own.size) / max(estimate, 1e-300))
        high = one.probability * math.exp(-_DISAGREE * relative) > estimate
        low = one.probability * math.exp(_DISAGREE * relative) < estimate
        if (high or low) and max(one.probability, estimate) > precision * total:
            return Undecided("disagreement", one.probability)
    return None
