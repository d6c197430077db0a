"""Polarity, order and lag of the channels of a two-drive, two-sense device, from its residues.

Of the family (paper, eqs. 9 to 11), with gains g > 0:

    up-down             R_3 = g_z K_S [[1, 1], [1, 1]] K_D              all signs positive
    rocking, both modes R_1 + R_2 = g_r K_S M_S M_D K_D,   M_S M_D = [[0, -2], [-2, 0]]

whatever theta, split and damping axes are, since the modes' residues add up to the first Markov parameter.  A
sample lag of tau turns the residue of a pole p by exp(-p tau).

- lag: where both are large, R_3 and R_1 + R_2 have opposite signs, which fixes tau to +-91 samples at 10 kHz; then
  R_3 must be real, which refines it.
- polarity: the signs of R_3.  Turning a sense and a drive channel together, or all, changes nothing that is linear.
- order: R_1 + R_2 lies off the diagonal; on it where the senses or the drives are swapped (which of them cannot be
  told: the two differ in the sign of theta).  Both swapped is a mirror image, and invisible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ..antialias import filter_response
from ..forward.modal_bank import hold_gains
from ..instrument import Hold, Instrument
from .response import Response

#: Rocking modes lie closer to each other than this share of their distance to the up-down mode.
_PAIR = 0.4
#: One diagonal of R_1 + R_2 must exceed the other by this factor.
_DOMINANCE = 3.0
#: Signs are read where a residue exceeds this many sd.
_CLEAR = 8.0
_MAX_LAG = 90.0


@dataclass(frozen=True, eq=False)
class Wiring:
    """What the residues say.

    sense_polarity, drive_polarity : of the channels as they are; swapped : the rocking residues lie on the
        diagonal, ``None`` where neither does; lag_samples, lag_sd : beyond what the declared hold and filter
        explain;
    confidence_sd : the weakest residue that decides a sign, over its sd; poles_hz : of rocking, rocking,
        up-down.
    """

    sense_polarity: tuple[int, int]
    drive_polarity: tuple[int, int]
    swapped: bool | None
    lag_samples: float
    lag_sd: float
    confidence_sd: float
    poles_hz: tuple[float, ...]


def hold_factor(pole: complex, sample_rate_hz: float, hold: Hold) -> complex:
    """Residue of the held samples over that of the continuous drive, (g0 + g1 z) / (z T)."""
    if hold == "bandlimited":
        return 1.0 + 0.0j
    z, g0, g1 = hold_gains(np.array([pole]), 1.0 / sample_rate_hz, hold)
    return complex(((g0 + g1 * z) / z)[0]) * sample_rate_hz


def _groups(response: Response) -> tuple[list[int], int] | None:
    """Rocking pair and up-down mode: the one that stands apart."""
    order = [int(k) for k in np.argsort(response.poles.imag)]
    if len(order) != 3:
        return None
    w = response.poles.imag[order]
    if w[1] - w[0] < _PAIR * (w[2] - w[1]):
        return order[:2], order[2]
    if w[2] - w[1] < _PAIR * (w[1] - w[0]):
        return order[1:], order[0]
    return None


def _turned(R: ComplexArray, pole: complex, instrument: Instrument) -> ComplexArray:
    """R without the declared hold and filter."""
    known = hold_factor(pole, instrument.sample_rate_hz, instrument.hold)
    return R / (known * complex(filter_response(instrument.antialias, np.array([pole]))[0]))


def _signs(R: FloatArray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Fewest turned channels whose product has the signs of R (2, 2); senses before drives."""
    options = [(a, b, c, d) for a in (1, -1) for b in (1, -1) for c in (1, -1) for d in (1, -1)]
    fitting = [o for o in options if np.array_equal(np.outer(o[:2], o[2:]), np.sign(R))]
    if not fitting:
        return None
    best = min(fitting, key=lambda o: (o.count(-1), o[2:].count(-1), o[0] == -1))
    return (best[0], best[1]), (best[2], best[3])


def wiring(response: Response, instrument: Instrument) -> Wiring | str:
    """Polarity, order and lag, or why they cannot be told."""
    if response.residues.shape[1:] != (2, 2):
        return "polarity and order are known for devices with two drives and two senses only"
    groups = _groups(response)
    if groups is None:
        return "no two close modes and one apart stand out, so the device is not seen to be of the family"
    pair, apart = groups
    rocking, rocking_sd = response.summed(pair)
    updown, updown_sd = response.summed([apart])
    p3 = complex(response.poles[apart])
    weights = np.sum(np.abs(response.residues[pair]) ** 2, axis=(1, 2))
    ps = complex(np.sum(weights * response.poles[pair]) / np.sum(weights))
    if np.any(np.abs(updown) < _CLEAR * updown_sd):
        return "the up-down mode does not stand out of the noise in every channel"
    diagonal = float(np.abs(rocking[0, 0]) + np.abs(rocking[1, 1]))
    other = float(np.abs(rocking[0, 1]) + np.abs(rocking[1, 0]))
    swapped = diagonal > other
    places = [(0, 0), (1, 1)] if swapped else [(0, 1), (1, 0)]
    if any(np.abs(rocking[at]) < _CLEAR * rocking_sd[at] for at in places):
        return "the rocking modes do not stand out of the noise in every channel"
    rate = instrument.sample_rate_hz
    # The two modes of a pair share one factor: over their distance it turns by less than the noise.
    updown, rocking = _turned(updown, p3, instrument), _turned(rocking, ps, instrument)
    ratio = sum(complex(rocking[at] * np.conj(updown[at])) for at in places)
    coarse = float(np.angle(-ratio)) / (p3.imag - ps.imag)
    # Both places must agree on the sign that rocking has against up-down.
    turns = [complex(rocking[at] * np.conj(updown[at])) for at in places]
    if abs(np.angle(turns[0] * np.conj(turns[1]))) > 1.0 or abs(coarse * rate) > _MAX_LAG:
        return "rocking and up-down residues have no common sign at any lag: the device is not of the family"
    phase = float(np.angle(np.sum(updown**2))) / 2.0
    steps = round((coarse * p3.imag + phase) / math.pi)
    tau = (steps * math.pi - phase) / p3.imag
    sd = float(np.sqrt(np.sum(updown_sd**2 * np.abs(updown) ** 2)) / np.sum(np.abs(updown) ** 2)) / p3.imag
    real = np.real(updown * np.exp(1j * p3.imag * tau))
    signs = _signs(real)
    if signs is None:
        return "the signs of the up-down mode fit no polarity of the channels"
    clear = min(
        float(np.min(np.abs(updown) / updown_sd)), *(float(np.abs(rocking[at]) / rocking_sd[at]) for at in places)
    )
    decided = max(diagonal, other) > _DOMINANCE * min(diagonal, other)
    return Wiring(
        sense_polarity=signs[0],
        drive_polarity=signs[1],
        swapped=swapped if decided else None,
        lag_samples=tau * rate,
        lag_sd=sd * rate,
        confidence_sd=clear,
        poles_hz=tuple(float(response.poles[k].imag) / (2.0 * math.pi) for k in (*pair, apart)),
    )
