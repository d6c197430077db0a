"""A rare loss: its probability, estimated from weighted devices, with its uncertainty.

    p = 1/N sum_i w_i l_i,   sd^2 = (mean of (w l)^2 - p^2) / N,   ESS = (sum w l)^2 / sum (w l)^2     l_i = 1 where lost

95 % interval: p exp(-+ 1.96 sd/p), because p is positive and its distribution skew; Clopper-Pearson where all weights are one.

Shapes: N devices.
Source: Owen, Monte Carlo theory, methods and examples (2013), ch. 9.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import ndtri

from pipeline.arrays import BoolArray, FloatArray

from .yields import LEVEL, clopper_pearson

#: Fewest effective lost devices of a decided loss: its sd is then known to about a tenth, and its interval holds.
LEAST_ESS = 50.0


@dataclass(frozen=True)
class Undecided:
    """Why a loss is undecided, and the probability that belongs to the reason.

    ``not_found``: no lost device was found above this probability; ``plateau``: no way leads on from it; ``disagreement``:
    subset simulation gives this probability; ``few``: the effective number of lost devices; ``wide``: the relative half-width of
    the interval; ``none``: no device was lost.
    """

    reason: Literal["not_found", "plateau", "disagreement", "few", "wide", "none"]
    value: float


@dataclass(frozen=True)
class Loss:
    """The share of devices beyond a limit.

    Parameters
    ----------
    limit : its quantity, or "total".
    probability, low, high : estimate and 95 % interval [1].
    relative_sd : sd / probability; nan without lost devices.
    ess : effective number of lost devices.
    undecided : ``None`` where the estimate holds.
    """

    limit: str
    probability: float
    low: float
    high: float
    relative_sd: float
    ess: float
    undecided: Undecided | None


@dataclass(frozen=True)
class Driver:
    """A latent normal of lost devices: its name, mean and rms; 0 and 1 in the population."""

    latent: str
    mean: float
    rms: float


@dataclass(frozen=True, eq=False)
class RareLosses:
    """Losses to each limit and in total, what drives each, and how they were estimated.

    Parameters
    ----------
    losses : of each limit, then "total".
    drivers : limit -> the latent normals of lost devices that differ most from the population's, the strongest first.
    method : "importance" or "plain".
    devices, seed, dimension : devices that were computed, seed, number of latent normals.
    """

    losses: tuple[Loss, ...]
    drivers: Mapping[str, tuple[Driver, ...]]
    method: str
    devices: int
    seed: int
    dimension: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; nan is null."""
        return {
            "losses": [
                {**_plain(loss), "drivers": [asdict(d) for d in self.drivers[loss.limit]]} for loss in self.losses
            ],
            "method": self.method,
            "devices": self.devices,
            "seed": self.seed,
            "latent_normals": self.dimension,
        }


def _plain(loss: Loss) -> dict[str, Any]:
    return {
        "limit": loss.limit,
        "probability": loss.probability,
        "interval": [loss.low, loss.high],
        "relative_sd": None if math.isnan(loss.relative_sd) else loss.relative_sd,
        "ess": loss.ess,
        "undecided": None if loss.undecided is None else asdict(loss.undecided),
    }


def driver_of(latent: str, weight: FloatArray, z: FloatArray) -> Driver:
    """Mean and rms of the values z (N,) of a latent normal of lost devices, whose weights (N,) add up to one."""
    return Driver(latent, float(weight @ z), math.sqrt(float(weight @ (z * z))))


def loss_of(limit: str, weight: FloatArray, lost: BoolArray, precision: float, doubt: Undecided | None) -> Loss:
    """The loss from N devices with weights (N,) that are lost or not (N,).

    Parameters
    ----------
    limit : its name.
    precision : largest relative half-width of the 95 % interval of a decided loss.
    doubt : why the devices do not represent the loss; takes precedence over what they show.
    """
    n = weight.size
    part = weight * lost
    probability = float(np.mean(part))
    if not np.any(lost):
        high = clopper_pearson(0, n).high if np.all(weight == 1.0) else 1.0
        return Loss(limit, 0.0, 0.0, high, math.nan, 0.0, doubt or Undecided("none", 0.0))
    relative_sd = float(np.std(part)) / math.sqrt(n) / probability
    ess = float(np.sum(part) ** 2 / np.sum(part**2))
    half = float(ndtri(0.5 + 0.5 * LEVEL)) * relative_sd
    low, high = probability * math.exp(-half), min(probability * math.exp(half), 1.0)
    if np.all(weight == 1.0):
        exact = clopper_pearson(int(np.count_nonzero(lost)), n)
        low, high = exact.low, exact.high
    reason = doubt
    if reason is None and ess < LEAST_ESS:
        reason = Undecided("few", ess)
    if reason is None and half > precision:
        reason = Undecided("wide", half)
    return Loss(limit, probability, low, high, relative_sd, ess, reason)
