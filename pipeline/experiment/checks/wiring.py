"""Polarity, order and lag of the channels of a device with two drives and two senses, from its residues.

For a gyro with two rocking modes and one up-down mode (paper, eqs. 9 to 11), with gains g > 0:

    up-down             R_3 = g_z K_S [[1, 1], [1, 1]] K_D              all signs positive
    rocking, both modes R_1 + R_2 = g_r K_S M_S M_D K_D,   M_S M_D = [[0, -2], [-2, 0]]

This holds for every theta, split and damping, because the residues of the two rocking modes add up to the first Markov
parameter.  A lag of tau multiplies the residue of a pole p by exp(-p tau).

- lag: R_3 and R_1 + R_2 have opposite signs where both are large, which fixes tau to +-91 samples at 10 kHz; then R_3 must be
  real, which refines tau.
- pick-off: a lag turns modes by different angles, a pick-off of the other kind turns all by a quarter.  The coarse lag, from the
  difference of the modes, tells them apart.
- polarity: the signs of R_3.  Inverting one sense and one drive, or all channels, leaves a linear device unchanged.
- order: R_1 + R_2 lies off the diagonal.  It lies on the diagonal if the senses or the drives are swapped; the two cases
  differ only in the sign of theta.  If both are swapped, the device is mirrored, which no linear response shows.

Shapes: residues (S, D) = (2, 2) [1/s].  Poles in rad/s, tau in seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ..antialias import filter_response
from ..forward.modal_bank import hold_gains
from ..instrument import Hold, Instrument, Pickoff
from .response import Response

#: The rocking modes are closer to each other than this share of their distance to the up-down mode.
_PAIR = 0.4
#: One diagonal of R_1 + R_2 must exceed the other by this factor for the order to be decided.
DOMINANCE = 3.0
#: A residue must exceed this many sd for its sign to count.
_CLEAR = 8.0
_MAX_LAG = 90.0
#: Least sd of the coarse lag, as a share of a quarter period: an undeclared filter delays the modes differently by some percent.
_SHARE = 0.05
#: Distance in sd beyond which a pick-off is excluded.
_OTHER = 5.0

_OTHER_DEVICE = "this does not look like a gyro with two rocking modes and one up-down mode"


@dataclass(frozen=True, eq=False)
class Wiring:
    """Polarity, order and lag of the channels.

    Parameters
    ----------
    sense_polarity, drive_polarity : +1 or -1 for each channel as recorded.
    swapped : whether the rocking residues lie on the diagonal; ``None`` where neither diagonal dominates.
    lag_samples, lag_sd : lag of the senses beyond the declared hold and filter, and its sd.
    confidence_sd : the smallest residue that decides a sign, over its sd.
    poles_hz : frequencies of rocking, rocking, up-down [Hz].
    pickoff : what the phase of the residues shows, "velocity" or "displacement"; the lag is that beyond it.
    pickoff_sd : how far the phase is from that of the other one, in sd; 0 where the two are not told apart.
    """

    sense_polarity: tuple[int, int]
    drive_polarity: tuple[int, int]
    swapped: bool | None
    lag_samples: float
    lag_sd: float
    confidence_sd: float
    poles_hz: tuple[float, ...]
    pickoff: Pickoff
    pickoff_sd: float


def hold_factor(pole: complex, sample_rate_hz: float, hold: Hold) -> complex:
    """Residue with held drive samples over the residue of the continuous system, (g0 + g1 z) / (z T) [1]; pole [rad/s]."""
    if hold == "bandlimited":
        return 1.0 + 0.0j
    z, g0, g1 = hold_gains(np.array([pole]), 1.0 / sample_rate_hz, hold)
    return complex(((g0 + g1 * z) / z)[0]) * sample_rate_hz


def _rocking_and_updown(response: Response) -> tuple[list[int], int] | None:
    """Indices of the rocking pair and of the up-down mode; ``None`` where neither distance nor residues show them.

    The residues of the pair add up to a matrix with one empty diagonal.  Of the groupings for which they do, the pair is the
    closest; where they do for none, it is a pair that is much closer to each other than to the third mode.
    """
    if len(response.poles) != 3:
        return None
    w = response.poles.imag
    groupings = sorted((([0, 1], 2), ([0, 2], 1), ([1, 2], 0)), key=lambda g: abs(w[g[0][0]] - w[g[0][1]]))
    for pair, single in groupings:
        sizes = _diagonals(response.summed(pair)[0])
        if max(sizes) > DOMINANCE * min(sizes):
            return pair, single
    pair, single = groupings[0]
    apart = min(abs(w[single] - w[k]) for k in pair)
    return groupings[0] if abs(w[pair[0]] - w[pair[1]]) < _PAIR * apart else None


def _diagonals(R: ComplexArray) -> tuple[float, float]:
    """Sums of the absolute values on and off the diagonal of R (2, 2)."""
    return float(np.abs(R[0, 0]) + np.abs(R[1, 1])), float(np.abs(R[0, 1]) + np.abs(R[1, 0]))


def _without_hold_and_filter(R: ComplexArray, pole: complex, instrument: Instrument) -> ComplexArray:
    """Residues R (2, 2) divided by the factors of the declared hold and filter at ``pole``."""
    known = hold_factor(pole, instrument.sample_rate_hz, instrument.hold)
    return R / (known * complex(filter_response(instrument.antialias, np.array([pole]))[0]))


def _polarities(R: FloatArray) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Sense and drive polarities whose product has the signs of R (2, 2): the fewest inverted channels, senses first."""
    options = [(a, b, c, d) for a in (1, -1) for b in (1, -1) for c in (1, -1) for d in (1, -1)]
    fitting = [o for o in options if np.array_equal(np.outer(o[:2], o[2:]), np.sign(R))]
    if not fitting:
        return None
    best = min(fitting, key=lambda o: (o.count(-1), o[2:].count(-1), o[0] == -1))
    return (best[0], best[1]), (best[2], best[3])


def _nearest(coarse: float, phase: float, omega: float) -> float:
    """The lag [s] nearest to ``coarse`` that makes a residue of this phase at ``omega`` [rad/s] real."""
    return (round((coarse * omega + phase) / math.pi) * math.pi - phase) / omega


def _phase_sd(R: ComplexArray, sd: FloatArray) -> float:
    return float(np.sqrt(np.sum(sd**2 * np.abs(R) ** 2)) / np.sum(np.abs(R) ** 2))


def wiring(response: Response, instrument: Instrument) -> Wiring | str:
    """Polarity, order and lag; or, as a clause for the user, why they cannot be determined."""
    if response.residues.shape[1:] != (2, 2):
        return "these tests need two drives and two senses"
    groups = _rocking_and_updown(response)
    if groups is None:
        found = ", ".join(f"{hz:.4g}" for hz in np.sort(response.poles.imag) / (2.0 * math.pi))
        return f"{_OTHER_DEVICE} (modes at {found} Hz)"
    pair, single = groups
    rocking, rocking_sd = response.summed(pair)
    updown, updown_sd = response.summed([single])
    p3 = complex(response.poles[single])
    weights = np.sum(np.abs(response.residues[pair]) ** 2, axis=(1, 2))
    ps = complex(np.sum(weights * response.poles[pair]) / np.sum(weights))
    if np.any(np.abs(updown) < _CLEAR * updown_sd):
        weakest = float(np.min(np.abs(updown) / updown_sd))
        return f"the up-down mode is too weak in one channel ({weakest:.1f} sd, {_CLEAR:g} sd needed)"
    diagonal, off_diagonal = _diagonals(rocking)
    swapped = diagonal > off_diagonal
    entries = [(0, 0), (1, 1)] if swapped else [(0, 1), (1, 0)]
    if any(np.abs(rocking[at]) < _CLEAR * rocking_sd[at] for at in entries):
        weakest = min(float(np.abs(rocking[at]) / rocking_sd[at]) for at in entries)
        return f"the rocking modes are too weak in one channel ({weakest:.1f} sd, {_CLEAR:g} sd needed)"
    rate = instrument.sample_rate_hz
    # One factor serves both modes of a pair: between their frequencies it changes by less than the noise.
    raw_rocking = rocking
    updown = _without_hold_and_filter(updown, p3, instrument)
    rocking = _without_hold_and_filter(rocking, ps, instrument)
    ratio = sum(complex(rocking[at] * np.conj(updown[at])) for at in entries)
    coarse = float(np.angle(-ratio)) / (p3.imag - ps.imag)
    # Both entries must give the same sign of rocking relative to up-down.
    products = [complex(rocking[at] * np.conj(updown[at])) for at in entries]
    if abs(np.angle(products[0] * np.conj(products[1]))) > 1.0 or abs(coarse * rate) > _MAX_LAG:
        return (
            f"no lag within +-{_MAX_LAG:g} samples gives rocking and up-down residues opposite signs: {_OTHER_DEVICE}"
        )
    pickoff, pickoff_sd = instrument.pickoff, 0.0
    phase = float(np.angle(np.sum(updown**2))) / 2.0
    tau = _nearest(coarse, phase, p3.imag)
    turned = _nearest(coarse, phase + 0.5 * math.pi, p3.imag)
    noise = _phase_sd(updown, updown_sd), *(float(rocking_sd[at] / np.abs(raw_rocking[at])) for at in entries)
    coarse_sd = max(math.hypot(*noise) / abs(p3.imag - ps.imag), _SHARE * math.pi / (2.0 * p3.imag))
    away, turned_away = abs(tau - coarse) / coarse_sd, abs(turned - coarse) / coarse_sd
    if away > _OTHER and turned_away < _OTHER:
        pickoff = "displacement" if instrument.pickoff == "velocity" else "velocity"
        updown, tau = updown * (1j if pickoff == "displacement" else -1j), turned
    if max(away, turned_away) > _OTHER:
        pickoff_sd = max(away, turned_away)
    sd = float(np.sqrt(np.sum(updown_sd**2 * np.abs(updown) ** 2)) / np.sum(np.abs(updown) ** 2)) / p3.imag
    real = np.real(updown * np.exp(1j * p3.imag * tau))
    signs = _polarities(real)
    if signs is None:
        return "no combination of inverted channels gives the signs of the up-down residues"
    clear = min(
        float(np.min(np.abs(updown) / updown_sd)), *(float(np.abs(rocking[at]) / rocking_sd[at]) for at in entries)
    )
    decided = max(diagonal, off_diagonal) > DOMINANCE * min(diagonal, off_diagonal)
    return Wiring(
        sense_polarity=signs[0],
        drive_polarity=signs[1],
        swapped=swapped if decided else None,
        lag_samples=tau * rate,
        lag_sd=sd * rate,
        confidence_sd=clear,
        pickoff=pickoff,
        pickoff_sd=pickoff_sd,
        poles_hz=tuple(float(response.poles[k].imag) / (2.0 * math.pi) for k in (*pair, single)),
    )
