"""The effects that a fit lacks, and their signatures in the band of a record.

Shapes: S = 2 senses, W bins, k parameters of an effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import ComplexArray, FloatArray
from ....device.effect import Effect
from ....device.model import Model
from ....device.parameters import Parameter, Shape
from ..mismatch import NIGHTLY_MODEL

SHAPE: Shape = NIGHTLY_MODEL.built.shape


@dataclass(frozen=True, eq=False)
class BandSignature:
    """Change of the spectrum (S, W) [V] of a record at unit strength, and the range (low, high) of the strength.

    The strength is a parameter in its unit, its square for a law of second order, or the share of a probe of an ADC.
    """

    effect: str
    spectrum: ComplexArray
    low: float
    high: float


@lru_cache(maxsize=4)
def scored_effects(with_mismatch: bool) -> tuple[Effect, ...]:
    """The effects of the library that a fit lacks: neither in its model nor inside an effect of its model."""
    model = NIGHTLY_MODEL if with_mismatch else Model(effects=NIGHTLY_MODEL.effects[:-1])
    found = (model.effect(name) for name in model.candidates())
    own = set(model.effects)
    return tuple(e for e in found if not any(other.always and set(other.effects) <= own for other in e.look_alikes))


def probed(effect: Effect, member: Parameter, change: ComplexArray, probe: float, order: int) -> BandSignature:
    """The signature per unit of the parameter, or of its square, from the change by a probe."""
    high = max(abs(member.low), abs(member.high)) ** 2 if order == 2 else member.high
    return BandSignature(effect.name, change / probe**order, 0.0 if order == 2 else min(member.low, 0.0), high)


@lru_cache(maxsize=256)
def members_of(effect: Effect) -> tuple[Parameter, ...]:
    """Parameters of an effect on the gyro, families expanded."""
    return effect.members(SHAPE)


def only(size: int, i: int, value: float) -> FloatArray:
    """Parameters (k,) of which only number ``i`` is not zero."""
    p = np.zeros(size)
    p[i] = value
    return p
