"""The effects that a fit lacks, and their signatures in the band of a record.

Shapes: S = 2 senses, W bins, k parameters of an effect.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ....arrays import AnyComplexArray, ComplexArray, FloatArray
from ....device.effect import Effect, LookAlike
from ....device.model import Model
from ....device.parameters import Parameter, Shape
from ..mismatch import NIGHTLY_MODEL
from .bounds import Candidates

SHAPE: Shape = NIGHTLY_MODEL.built.shape


@dataclass(frozen=True, eq=False)
class BandSignature:
    """Change of the spectrum of a record as a row of real numbers, and the range (low, high) of its strength.

    The row (S, 2 W) [V] has real parts before imaginary ones.  The strength is a parameter in its unit, its square for a law of
    second order, or the share of a probe of an ADC; ``per_unit`` is what turns the row into that at unit strength.
    """

    effect: str
    row: FloatArray
    low: float
    high: float
    per_unit: float = 1.0

    @property
    def spectrum(self) -> ComplexArray:
        """The change (S, W) [V] at unit strength."""
        real, imaginary = np.split(self.row * self.per_unit, 2, axis=1)
        return np.asarray(real + 1j * imaginary)


@lru_cache(maxsize=4)
def scored_effects(with_mismatch: bool) -> tuple[Effect, ...]:
    """The effects of the library that a fit lacks: neither in its model nor inside an effect of its model.

    An effect that is always the sum of others has no score of its own: theirs show it.
    """
    model = NIGHTLY_MODEL if with_mismatch else Model(effects=NIGHTLY_MODEL.effects[:-1])
    found = [model.effect(name) for name in model.candidates()]
    own = set(model.effects)
    known = own | {effect.name for effect in found}

    def shown(like: LookAlike) -> bool:
        return like.always and set(like.effects) <= (known if len(like.effects) > 1 else own)

    return tuple(effect for effect in found if not any(shown(like) for like in effect.look_alikes))


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
    """One parameter of an effect, which acts alone: the effect, the parameter, its number ``i`` of ``size``.

    ``scanned``: number and value of the parameters that are scanned; all others are zero.
    """

    effect: Effect
    member: Parameter
    i: int
    size: int
    scanned: tuple[tuple[int, float], ...] = ()

    def at(self, value: float) -> FloatArray:
        """Parameters (k,) of the effect with this one at ``value``, in its unit."""
        p = only(self.size, self.i, value)
        for i, fixed in self.scanned:
            p[i] = fixed
        return p

    @cached_property
    def ranges(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Ranges of the share of a probe, of the parameter, and of its square: those of an ``Acting`` by its order."""
        m = self.member
        return (0.0, math.inf), (min(m.low, 0.0), m.high), (0.0, max(abs(m.low), abs(m.high)) ** 2)


class Acting(NamedTuple):
    """A parameter at a value, and the order in it of its change of a record; order 0: a change as a whole, of any share."""

    probe: Probe
    value: float
    order: int

    def signature(self, row: FloatArray) -> BandSignature:
        """The signature per unit of the parameter to the power ``order``, from its change as a row (S, 2 W) [V]."""
        low, high = self.probe.ranges[self.order]
        return BandSignature(self.probe.effect.name, row, low, high, self.value**-self.order)


class Changed(NamedTuple):
    """Parameters that act, and the change of the spectra (k, S, W) [V] by each."""

    acting: Sequence[Acting]
    spectra: AnyComplexArray


def candidates_of(acting: Sequence[Acting]) -> Candidates:
    """The effects of parameters that act, with the ranges of their strengths in units of their rows."""
    probes, values, orders = zip(*acting)
    effects, low, high = _ranges_of(probes, orders)
    per_unit = np.array(values) ** -np.array(orders, dtype=np.float64)
    return Candidates(effects, low * per_unit, high * per_unit)


@lru_cache(maxsize=16)
def _ranges_of(probes: tuple[Probe, ...], orders: tuple[int, ...]) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Effects, and both ends (K,) of the ranges of their strengths, which most devices share."""
    low, high = np.array([probe.ranges[order] for probe, order in zip(probes, orders)]).T
    return tuple(probe.effect.name for probe in probes), low, high


@lru_cache(maxsize=32)
def probes_of(with_mismatch: bool, stage: str) -> tuple[Probe, ...]:
    """All parameters of the scored effects that act on a ``stage`` of the signal path.

    A force with coordinates of its own is not scored: the linear motion of the device does not move them.
    """
    effects = [e for e in scored_effects(with_mismatch) if getattr(e, stage) is not None and not e.has_coordinates]
    return tuple(probe for effect in effects for probe in _probes(effect))


#: The stages whose effects are forces, and all that have signatures.
FORCES = ("drive", "force")
STAGES = (*FORCES, "mechanics", "sense", "readout", "adc")


@lru_cache(maxsize=8)
def most_signatures(with_mismatch: bool, stages: tuple[str, ...]) -> int:
    """The largest number of signatures of some stages in a record."""
    return sum(len(probes_of(with_mismatch, stage)) for stage in stages)


def write_real(spectra: AnyComplexArray, out: FloatArray) -> None:
    """Write spectra (.., W) as real numbers to ``out`` (.., 2 W): real parts before imaginary ones."""
    width = spectra.shape[-1]
    out[..., :width], out[..., width:] = spectra.real, spectra.imag


def _probes(effect: Effect) -> tuple[Probe, ...]:
    """The parameters of an effect; where some are scanned, the others at both ends of the scans, which span those between."""
    own = members_of(effect)
    scans = [i for i, m in enumerate(own) if m.grid]
    if len(scans) in (0, len(own)):
        return tuple(Probe(effect, m, i, len(own)) for i, m in enumerate(own))
    ends = product(*[(own[i].grid[0], own[i].grid[-1]) for i in scans])
    points = [tuple(zip(scans, at)) for at in ends]
    return tuple(Probe(effect, m, i, len(own), at) for i, m in enumerate(own) if not m.grid for at in points)
