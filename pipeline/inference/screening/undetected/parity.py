"""What a force law is as a function of the motion: linear, odd, even or mixed, and its order in a parameter.

    f(-a) = -f(a): odd,  f(-a) = f(a): even,  f(2 a) = 2 f(a): linear,     a = (q, q', u)

An odd law returns into the band at once, in first order of its parameter.  An even one does so through the motion that it
causes, in second order; a mixed one may do both.  This is a property of the law and not of the device, so it is found once, at
fixed points, and tells how few phases give the harmonics (``narrow_band``): over half a turn the harmonics of one parity are
right, and those of the other are not.

Shapes: 3 coordinates, 2 drives, k parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ....arrays import FloatArray
from ....device.device_forces import takes_devices
from ....device.force_law import Laws, Points, force_along, in_single, single_force_along
from .library import Probe
from .narrow_band import QUIET, WHOLE_TURN, Phases, at_phases, harmonics

#: Relative size of a part of a law that counts as rounding.
_ROUNDING = 1e-9
#: Relative error of a force in single precision that is accepted: a hundred times its rounding.
_IN_SINGLE = 6e-6
#: Typical motion [V s], velocity [V] and drive [V] of the points.
_MOTION, _VELOCITY, _DRIVE, _POINTS = 1e-4, 0.3, 1.0, 8
#: Phases of half a turn that are tried, those that count as exact, and the error of the first harmonic that is accepted.
_COUNTS, _MANY, _FOLDED = (4, 8, 16), 64, 0.02


@dataclass(frozen=True, eq=False)
class LawKind:
    """Kind of a force law in one parameter.

    Parameters
    ----------
    phases : at which the law is taken.
    linear, even : whether it is linear or even; neither if it is odd or mixed.
    order : of what returns into the band in the parameter, 1 or 2.
    still : whether it does not depend on the motion.
    fades : whether it is negligible in quiet parts of a record, because it grows as the square of the motion at least.
    single : whether it is right in single precision: it takes devices together, and no difference in it cancels its digits.
    acts : the coordinates on which it acts.
    """

    phases: Phases
    linear: bool
    even: bool
    order: int
    still: bool = False
    fades: bool = True
    single: bool = True
    acts: tuple[int, ...] = (0, 1, 2)


def _half_turn(force: Callable[..., None], p: FloatArray, laws: Laws, q: FloatArray, qd: FloatArray) -> Phases:
    """The fewest phases that give the first harmonic of an odd law of tones q, qd (3, m) to ``_FOLDED``.

    With M phases of half a turn the harmonic 2 M - 1 is folded into the first.  |x| x is right to 1 % with 4, a friction
    needs more.
    """
    first = {}
    for count in (*_COUNTS, _MANY):
        phases = Phases(count, 0.5)
        # A quarter of a turn between place and velocity.
        points = at_phases(np.concatenate([q.astype(np.complex128), -1.0j * qd]), phases)
        motion = Points(np.ones(points.shape[1]), points[:3], points[3:], np.zeros((2, points.shape[1])))
        (first[count],) = harmonics(force_along(force, motion, p, laws), phases, 1)
    size = _FOLDED * float(np.linalg.norm(first[_MANY]))
    enough = [count for count in _COUNTS if np.linalg.norm(first[count] - first[_MANY]) <= size]
    return Phases(min(enough, default=_COUNTS[-1]), 0.5)


@lru_cache(maxsize=256)
def kind_of(probe: Probe) -> LawKind:
    """Kind of the force of an effect in one of its parameters."""
    force, p = probe.effect.force, probe.at(probe.member.scale)
    assert force is not None
    motion, laws = _points()
    exact, single = force_along(force, motion, p, laws), takes_devices(force, p.size)
    if single:
        rough = np.empty(motion.q.shape, dtype=np.float32)
        single_force_along(force, motion.single, p, in_single(laws), rough)
        single = bool(np.linalg.norm(rough - exact) <= _IN_SINGLE * np.linalg.norm(exact))
    kind = _kind(force, p, motion, laws)
    # A law that is zero at the points may act elsewhere.
    acts = tuple(np.flatnonzero(exact.any(axis=1)).tolist()) or kind.acts
    return replace(kind, single=single, acts=acts)


def _points() -> tuple[Points, Laws]:
    """Fixed points of a motion, and fixed mechanics."""
    random = np.random.default_rng(0)
    q, qd, u = (
        scale * random.standard_normal((size, _POINTS)) for scale, size in ((_MOTION, 3), (_VELOCITY, 3), (_DRIVE, 2))
    )
    matrix = random.standard_normal((3, 3))
    laws = Laws(matrix, matrix, random.standard_normal((3, 2)), random.standard_normal((2, 3)), 5.0, 5.0, 2)
    return Points(np.ones(_POINTS), q, qd, u), laws


def _kind(force: Callable[..., None], p: FloatArray, motion: Points, laws: Laws) -> LawKind:
    q, qd, u = motion.q, motion.qd, motion.u

    def at(factor: float, strength: float = 1.0) -> FloatArray:
        return force_along(force, Points(np.ones(_POINTS), factor * q, factor * qd, factor * u), strength * p, laws)

    plus, minus = at(1.0), at(-1.0)
    size = _ROUNDING * float(np.linalg.norm(plus))
    if np.linalg.norm(at(2.0) - 2.0 * plus) <= size:
        return LawKind(Phases(2, 0.5), True, False, 1, fades=False)
    if np.linalg.norm(plus + minus) <= size:
        # A friction is viscous in quiet parts, where it damps most.
        fades = float(np.linalg.norm(at(QUIET))) <= QUIET**1.5 * float(np.linalg.norm(plus))
        return LawKind(_half_turn(force, p, laws, q, qd), False, False, 1, fades=fades)
    if np.linalg.norm(plus - minus) <= size:
        rest = force_along(force, Points(np.ones(_POINTS), 0.0 * q, 0.0 * qd, u), p, laws)
        return LawKind(WHOLE_TURN, False, True, 2, still=bool(np.linalg.norm(rest - plus) <= size))
    odd, half = (at(1.0, strength) - at(-1.0, strength) for strength in (1.0, 0.5))
    order = 2 if float(np.linalg.norm(odd)) > 3.0 * float(np.linalg.norm(half)) else 1
    return LawKind(WHOLE_TURN, False, False, order)
