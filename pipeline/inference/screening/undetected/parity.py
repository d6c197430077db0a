"""What a force law is as a function of the motion: linear, odd, even or mixed, and its order in a parameter.

    f(-a) = -f(a): odd,  f(-a) = f(a): even,  f(2 a) = 2 f(a): linear,     a = (q, q', u)

An odd law returns into the band at once, in first order of its parameter.  An even one does so through the motion that it
causes, in second order; a mixed one may do both.  This is a property of the law and not of the device, so it is found once, at
fixed points, and tells how few phases give the harmonics (``narrow_band``): over half a turn the harmonics of one parity are
right, and those of the other are not.

Shapes: 3 coordinates, 2 drives, k parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ....arrays import FloatArray
from ....device.force_law import Laws, Points, force_along
from .library import Probe
from .narrow_band import WHOLE_TURN, Phases

#: Relative size of a part of a law that counts as rounding.
_ROUNDING = 1e-9
#: Typical motion [V s], velocity [V] and drive [V] of the points.
_MOTION, _VELOCITY, _DRIVE, _POINTS = 1e-4, 0.3, 1.0, 8


@dataclass(frozen=True, eq=False)
class LawKind:
    """Kind of a force law in one parameter.

    Parameters
    ----------
    phases : at which the law is taken.
    linear, even : whether it is linear or even; neither if it is odd or mixed.
    order : of what returns into the band in the parameter, 1 or 2.
    """

    phases: Phases
    linear: bool
    even: bool
    order: int


@lru_cache(maxsize=256)
def kind_of(probe: Probe) -> LawKind:
    """Kind of the force of an effect in one of its parameters."""
    random = np.random.default_rng(0)
    assert probe.effect.force is not None
    force, p = probe.effect.force, probe.at(probe.member.scale)
    q, qd, u = (
        scale * random.standard_normal((size, _POINTS)) for scale, size in ((_MOTION, 3), (_VELOCITY, 3), (_DRIVE, 2))
    )
    matrix = random.standard_normal((3, 3))
    laws = Laws(matrix, matrix, random.standard_normal((3, 2)), random.standard_normal((2, 3)), 5.0, 5.0, 2)

    def at(factor: float, strength: float = 1.0) -> FloatArray:
        return force_along(force, Points(np.ones(_POINTS), factor * q, factor * qd, factor * u), strength * p, laws)

    plus, minus = at(1.0), at(-1.0)
    size = _ROUNDING * float(np.linalg.norm(plus))
    if np.linalg.norm(at(2.0) - 2.0 * plus) <= size:
        return LawKind(Phases(2, 0.5), True, False, 1)
    if np.linalg.norm(plus + minus) <= size:
        # |x| x is right to 1 %: its seventh harmonic is folded into the first.
        return LawKind(Phases(4, 0.5), False, False, 1)
    if np.linalg.norm(plus - minus) <= size:
        return LawKind(WHOLE_TURN, False, True, 2)
    odd, half = (at(1.0, strength) - at(-1.0, strength) for strength in (1.0, 0.5))
    order = 2 if float(np.linalg.norm(odd)) > 3.0 * float(np.linalg.norm(half)) else 1
    return LawKind(WHOLE_TURN, False, False, order)
