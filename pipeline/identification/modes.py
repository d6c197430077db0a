"""Modes of an ARX model, discrete and continuous.

    H(z) = A(z)^-1 B(z) = sum_k R_k / (z - z_k) + ..,     R_k = v (w^H B(z_k)) / (w^H A'(z_k) v)
    A(z_k) v = 0,  w^H A(z_k) = 0

and, with the hold inverted, the continuous modes (p_k in the upper half plane, conj added):

    H(s) = sum_k R_k / (s - p_k) + conj = sum_k (s R1_k + R0_k) / (s^2 + 2 zeta_k omega_k s + omega_k^2)
    R1 = 2 Re R,   R0 = -2 Re(conj(p) R),   omega = |p|,   zeta = -Re p / |p|

Shapes: M modes, S senses, D drives.  Units: rad/s, volts per volt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import ComplexArray, FloatArray
from ..experiment.instrument import Hold
from .arx import ArxModel
from .failure import IdentificationError
from .poles import companion_poles, nearby_poles, polynomial_at, refine

TAU = 2.0 * np.pi
#: Half-widths of a resonance, to each side, that must lie in the band.
_HALF_WIDTHS = 3.0
#: Convergence limit of Newton's last correction, and the distance below which two poles count as the same pole.
_CONVERGED = 1e-10
_SAME = 1e-12


@dataclass(frozen=True, eq=False)
class DiscreteModes:
    """Poles z (M,) [1], Im > 0, by ascending frequency; residues (M, S, D) [1] of H(z)."""

    poles: ComplexArray
    residues: ComplexArray

    @property
    def peak(self) -> FloatArray:
        """|R_k|_2 / (1 - |z_k|) (M,) [1]: the H-infinity norm of each mode alone, for light damping."""
        return _largest_gain(self.residues) / np.abs(1.0 - np.abs(self.poles))


def _largest_gain(matrices: ComplexArray) -> FloatArray:
    """Largest singular value (M,) of matrices (M, S, D); of two by two in a tenth of the time of the general way.

    2 s1^2 = p + q + sqrt((p - q)^2 + 4 |r|^2),   R^H R = [[p, r], [conj r, q]]
    """
    if matrices.shape[1:] != (2, 2):
        return np.asarray(np.linalg.norm(matrices, ord=2, axis=(1, 2)))
    a, b, c, d = matrices.reshape(-1, 4).T
    p, q = np.abs(a) ** 2 + np.abs(c) ** 2, np.abs(b) ** 2 + np.abs(d) ** 2
    r = np.abs(a.conj() * b + c.conj() * d)
    return np.asarray(np.sqrt(0.5 * (p + q + np.hypot(p - q, 2.0 * r))))


@dataclass(frozen=True, eq=False)
class ContinuousModes:
    """H(s) = sum_k R_k/(s - p_k) + conj: p (M,) [rad/s], Im > 0, by ascending frequency; R (M, S, D) [1/s]."""

    poles: ComplexArray
    residues: ComplexArray

    @property
    def frequency_hz(self) -> FloatArray:
        """|p| / 2pi (M,) [Hz]."""
        return np.asarray(np.abs(self.poles) / TAU)

    @property
    def zeta(self) -> FloatArray:
        """Damping ratio -Re p / |p| (M,) [1]."""
        return np.asarray(-self.poles.real / np.abs(self.poles))

    @property
    def R1(self) -> FloatArray:
        """2 Re R (M, S, D): coefficient of s [1/s]."""
        return np.asarray(2.0 * self.residues.real)

    @property
    def R0(self) -> FloatArray:
        """-2 Re(conj(p) R) (M, S, D): constant coefficient [1/s^2]."""
        return np.asarray(-2.0 * (np.conj(self.poles)[:, None, None] * self.residues).real)


def modes_from_fractions(frequency_hz: FloatArray, zeta: FloatArray, R1: FloatArray, R0: FloatArray) -> ContinuousModes:
    """Poles and residues of (s R1 + R0) / (s^2 + 2 zeta w s + w^2):  R = (p R1 + R0) / (p - conj p).

    Parameters
    ----------
    frequency_hz, zeta : (M,) w / 2pi [Hz] and damping ratio in [0, 1).
    R1, R0 : (M, S, D) [1/s, 1/s^2].
    """
    omega = TAU * frequency_hz
    poles = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    p = poles[:, None, None]
    return ContinuousModes(poles, (p * R1 + R0) / (2j * p.imag))


def residues_at(model: ArxModel, poles: ComplexArray) -> ComplexArray:
    """R_k (M, S, D) [1] of A(z)^-1 B(z) at zeros z (M,) of det A(z), by left and right null vectors."""
    n = model.order
    pairs = [polynomial_at(model.A, z) for z in poles]
    left, _, right = np.linalg.svd(np.array([value for value, _ in pairs]))
    slope = np.array([slope for _, slope in pairs])
    v, w = right[:, -1].conj(), left[:, :, -1].conj()
    # Both polynomials times z^n, which cancels in the quotient since P(z) v = 0.
    b = np.tensordot(poles[:, None] ** np.arange(n, -1, -1), model.B, axes=1)
    scale = np.einsum("ma,mab,mb->m", w, slope, v)
    return np.asarray(v[:, :, None] * np.einsum("ma,mad->md", w, b)[:, None] / scale[:, None, None])


def _companion_nearby(A: FloatArray, centre: complex) -> ComplexArray:
    return companion_poles(A)


def band_poles(model: ArxModel, sample_rate_hz: float, band_hz: tuple[float, float]) -> ComplexArray:
    """The distinct stable poles z (M,) [1] whose resonance lies in ``band_hz`` [Hz], by ascending frequency.

    A resonance lies in the band when arg z -+ 3 half-widths does, with half-width = -ln|z|.  Poles at the edges of the band
    describe the filter's edge, where nothing was driven, so their residues are arbitrary.
    """
    low, high = (TAU * f / sample_rate_hz for f in band_hz)
    centre = complex(np.exp(0.5j * (low + high)))
    # The disc through both ends of the band; well damped poles far inside the unit circle are not modes of the device.
    radius = 0.55 * (high - low)
    for seek in (nearby_poles, _companion_nearby):
        seeds = seek(model.A, centre)
        poles, last = refine(model.A, seeds[np.abs(seeds - centre) < radius])
        distinct = np.abs(poles[:, None] - poles[None, :]) + np.eye(poles.size) > _SAME
        if np.all(last < _CONVERGED) and np.all(distinct):
            break
    else:
        poles = poles[last < _CONVERGED]
    angle = np.angle(poles)
    reach = -_HALF_WIDTHS * np.log(np.abs(poles))
    kept = poles[(reach > 0.0) & (angle - reach > low) & (angle + reach < high)]
    return np.asarray(kept[np.argsort(np.angle(kept))])


def modes_of(
    model: ArxModel, sample_rate_hz: float, band_hz: tuple[float, float] = (400.0, 700.0), count: int = 3
) -> DiscreteModes:
    """The ``count`` modes of the model with the highest peaks |R_k|_2 / (1 - |z_k|) in the band.

    Parameters
    ----------
    model : ARX model.
    sample_rate_hz : f_s [Hz].
    band_hz : band in which modes are selected [Hz].
    count : number of modes.

    Raises
    ------
    IdentificationError : fewer stable modes than ``count`` lie in the band.
    """
    poles = band_poles(model, sample_rate_hz, band_hz)
    if poles.size < count:
        raise IdentificationError(
            f"the ARX model has too few stable modes between {band_hz[0]:g} and {band_hz[1]:g} Hz",
            value=int(poles.size),
            allowed=f"at least {count}",
            next_step="check that the record holds the resonances, or raise the order",
        )
    modes = DiscreteModes(poles, residues_at(model, poles))
    highest = np.sort(np.argsort(-modes.peak)[:count])
    return DiscreteModes(modes.poles[highest], modes.residues[highest])


def hold_gain(poles: ComplexArray, sample_rate_hz: float, hold: Hold) -> ComplexArray:
    """g(p) (M,) [s] such that R/(s - p) becomes g R/(z - e^{pT}) + const under the hold; p (M,) [rad/s], T = 1/f_s [s].

    zoh (e^{pT} - 1)/p;   foh (e^{pT} - 1)^2/(p^2 T);   bandlimited T e^{pT}
    """
    step = 1.0 / sample_rate_hz
    if hold == "zoh":
        return np.asarray(np.expm1(poles * step) / poles)
    if hold == "foh":
        return np.asarray((np.expm1(poles * step) / poles) ** 2 / step)
    return np.asarray(step * np.exp(poles * step))


def to_continuous(modes: DiscreteModes, sample_rate_hz: float, hold: Hold = "zoh") -> ContinuousModes:
    """Invert the hold:  p = f_s ln z [rad/s],  R_c = R_d / g(p) [1/s]."""
    poles: ComplexArray = np.asarray(sample_rate_hz * np.log(modes.poles), dtype=np.complex128)
    gain = hold_gain(poles, sample_rate_hz, hold)
    return ContinuousModes(poles, modes.residues / gain[:, None, None])
