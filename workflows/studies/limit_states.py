"""Limit states for the study of rare losses: closed forms, and limits of the default population.

All closed forms have 60 latent normals, as the default population has about as many; most of them have no influence.

Shapes: B devices, d latent normals.  Probabilities are exact, by the normal and chi2 distributions, or by quadrature.
Source: four branches: Waarts, Structural reliability using finite element methods (2000).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
from scipy.special import chdtri, ndtr, ndtri

from pipeline.arrays import FloatArray
from populations.spec import load_spec
from reports.limits import BoundsTable

from ..config import RunConfig, load_config
from ..config_tables import SamplingTable
from ..rare.estimate import LimitProblem

_DIMENSION = 60
#: A jump: share of devices with a leak, mean and sd of ln(rise) with one, sd without.
_LEAK, _RISE, _SPREAD, _TIGHT = 0.03, 2.0, 0.8, 0.25
_FOUR_BETA = 1.5


@dataclass(frozen=True)
class ClosedForm:
    """A limit state with a known loss: g (B, S) of z (B, d), and the probability that any side is above 0."""

    meaning: str
    probability: float
    responses: Callable[[FloatArray], FloatArray]
    sides: int = 1

    @property
    def problem(self) -> LimitProblem:
        """As one limit, "g"."""
        return LimitProblem(_DIMENSION, self.responses, {"g": tuple(range(self.sides))})


def _linear(probability: float) -> ClosedForm:
    beta = -float(ndtri(probability))
    return ClosedForm(
        f"sum of four latent normals, {probability:g}",
        probability,
        lambda z: 0.5 * np.sum(z[:, :4], axis=1)[:, None] - beta,
    )


def _two_sided(probability: float) -> ClosedForm:
    beta = -float(ndtri(probability))
    exact = float(ndtr(-beta) + ndtr(-beta - 0.3))

    def responses(z: FloatArray) -> FloatArray:
        return np.stack([z[:, 0] - beta, -z[:, 0] - beta - 0.3], axis=1)

    return ClosedForm("both ends of a limit, not equally far", exact, responses, 2)


def _sphere(dimension: int, probability: float) -> ClosedForm:
    square = float(chdtri(dimension, probability))
    return ClosedForm(
        f"outside of a sphere of {dimension} latent normals, {probability:g}",
        probability,
        lambda z: np.sum(z[:, :dimension] ** 2, axis=1)[:, None] - square,
    )


def _jump() -> ClosedForm:
    limit = 5.0
    exact = _LEAK * ndtr((_RISE - limit) / _SPREAD) + (1.0 - _LEAK) * ndtr(-limit / _TIGHT)

    def responses(z: FloatArray) -> FloatArray:
        rise = np.where(ndtr(z[:, 0]) < _LEAK, _RISE + _SPREAD * z[:, 1], _TIGHT * z[:, 2])
        return rise[:, None] - limit

    return ClosedForm("a share of 3 % leaks, the others do not", float(exact), responses)


def _four_branches(z: FloatArray) -> FloatArray:
    x, y = z[:, 0], z[:, 1]
    bent, r = 3.0 + 0.1 * (x - y) ** 2, math.sqrt(0.5)
    least = np.min([bent - (x + y) * r, bent + (x + y) * r, x - y + 7.0 * r, y - x + 7.0 * r], axis=0)
    return np.asarray(-least - _FOUR_BETA)[:, None]


def _four_probability() -> float:
    """By the rectangle rule over +-9 sd; exact to 1e-4: half the steps change it by less."""
    axis = np.linspace(-9.0, 9.0, 4001)
    density = np.exp(-0.5 * axis * axis) / math.sqrt(2.0 * math.pi)
    step, total = axis[1] - axis[0], 0.0
    for x, weight in zip(axis.tolist(), density.tolist()):
        lost = _four_branches(np.stack([np.full_like(axis, x), axis], axis=1))[:, 0] > 0.0
        total += weight * float(density @ lost)
    return float(total * step * step)


@lru_cache(maxsize=1)
def closed_forms() -> dict[str, ClosedForm]:
    """The closed forms by name."""
    return {
        "linear-1e-2": _linear(1e-2),
        "linear-1e-4": _linear(1e-4),
        "linear-1e-6": _linear(1e-6),
        "two-sided": _two_sided(1e-6),
        "ring": _sphere(2, 1e-6),
        "sphere-6": _sphere(6, 1e-6),
        "sphere-20": _sphere(20, 1e-6),
        "jump": _jump(),
        "four-branches": ClosedForm("four branches", _four_probability(), _four_branches),
    }


#: Limits of quantities of the default population: name -> quantity, ends.  Losses of about 0.2 %, then about 1 ppm.
POPULATION: dict[str, tuple[str, BoundsTable]] = {
    "split-common": ("split_hz", BoundsTable(max=6.2)),
    "frequency-common": ("f1_hz", BoundsTable(min=517.0, max=551.0)),
    "quality-common": ("quality3", BoundsTable(min=8.0)),
    "split-1ppm": ("split_hz", BoundsTable(max=9.4)),
    "frequency-1ppm": ("f1_hz", BoundsTable(min=506.5, max=561.5)),
    "quality-1ppm": ("quality3", BoundsTable(min=1.25)),
    "imbalance-1ppm": ("sense_imbalance", BoundsTable(min=-0.0243, max=0.0243)),
}


def population_config(name: str, seed: int, devices: int) -> RunConfig:
    """The default run with one limit of ``POPULATION`` and [sampling]."""
    quantity, ends = POPULATION[name]
    config = load_config(None, {"seed": seed})
    return msgspec.structs.replace(config, limits={quantity: ends}, sampling=SamplingTable(devices=devices))


def imbalance_loss(name: str) -> float | None:
    """The exact loss of a sense imbalance; ``None`` for other quantities.

    imbalance = tanh(D / 2),   D = ln K_2 - ln K_1 normal with variance 2 (sd_area^2 + 4 sd_gap^2)
    """
    quantity, ends = POPULATION[name]
    if quantity != "sense_imbalance" or ends.max is None:
        return None
    drawn = load_spec().irregularity
    area, gap = 0.01 * drawn["electrode_area"]["die_pct"], 0.01 * drawn["electrode_gap"]["die_pct"]
    sd = math.sqrt(2.0 * (area**2 + 4.0 * gap**2))
    return 2.0 * float(ndtr(-2.0 * math.atanh(ends.max) / sd))
