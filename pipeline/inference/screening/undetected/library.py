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
    """Change of the spectrum (S, W) [V] of a record, and the range (low, high) of its strength.

    The strength is a parameter in its unit, its square for a law of second order, or the share of a probe of an ADC; ``per_unit``
    is what turns the change into that at unit strength.
    """

    effect: str
    change: ComplexArray
    low: float
    high: float
    per_unit: float = 1.0

    @property
    def spectrum(self) -> ComplexArray:
        """The change (S, W) [V] at unit strength."""
        return self.change * self.per_unit


@lru_cache(maxsize=4)
def scored_effects(with_mismatch: bool) -> tuple[Effect, ...]:
    """The effects of the library that a fit lacks: neither in its model nor inside an effect of its model."""
    model = NIGHTLY_MODEL if with_mismatch else Model(effects=NIGHTLY_MODEL.effects[:-1])
    found = (model.effect(name) for name in model.candidates())
    own = set(model.effects)
    return tuple(e for e in found if not any(other.always and set(other.effects) <= own for other in e.look_alikes))


@lru_cache(maxsize=256)
def members_of(effect: Effect) -> tuple[Parameter, ...]:
    """Parameters of an effect on the gyro, families expanded."""
    return effect.members(SHAPE)


def only(size: int, i: int, value: float) -> FloatArray:
    """Parameters (k,) of which only number ``i`` is not zero."""
    p = np.zeros(size)
    p[i] = value
    return p


@dataclass(frozen=True, eq=False)
class Probe:
    """One parameter of an effect, which acts alone: the effect, the parameter, its number ``i`` of ``size``."""

    effect: Effect
    member: Parameter
    i: int
    size: int

    def at(self, value: float) -> FloatArray:
        """Parameters (k,) of the effect with this one at ``value``, in its unit, and all others zero."""
        return only(self.size, self.i, value)

    def signature(self, change: ComplexArray, value: float, order: int) -> BandSignature:
        """The signature per unit of the parameter, or of its square, from the change (S, W) [V] at ``value``."""
        m = self.member
        high = max(abs(m.low), abs(m.high)) ** 2 if order == 2 else m.high
        low = 0.0 if order == 2 else min(m.low, 0.0)
        return BandSignature(self.effect.name, change, low, high, value**-order)


@lru_cache(maxsize=32)
def probes_of(with_mismatch: bool, stage: str) -> tuple[Probe, ...]:
    """All parameters of the scored effects that act on a ``stage`` of the signal path."""
    effects = [effect for effect in scored_effects(with_mismatch) if getattr(effect, stage) is not None]
    members = [members_of(effect) for effect in effects]
    return tuple(Probe(e, m, i, len(own)) for e, own in zip(effects, members) for i, m in enumerate(own))
