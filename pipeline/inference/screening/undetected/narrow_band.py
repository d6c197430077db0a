"""Signals of a narrow band as envelopes, and the part of a nonlinear law that returns into the band.

    y(t) = Re{a(t) e^{i w0 t}},      a = Fourier sum over the bins of the band, w0 its middle

A law f of such signals is periodic in the phase w0 t at fixed envelopes,

    f = Re sum_h f_h(a) e^{i h w0 t},      f_h = (2/M) sum_m f(Re a e^{i phi_m}) e^{-i h phi_m},   phi_m = 2 pi m / M

so the part in the band is h = 1, at a thousand points instead of all samples.  This is an identity, not an average over a
period; harmonics from M - 1 upwards are folded.  Even laws give no h = 1.  Their h = 0 and 2 move the device quasi-statically,
and that motion mixes with the signal back into the band:

    d = K^-1 f_0 / 2 + Re{(K - 4 w0^2)^-1 f_2 e^{2 i w0 t}},      f_1(a, d)

Points at which the device has not reached its resonances yet count as zero.

Shapes: n points over the record, n' of them loud, 3 coordinates, D drives, S senses, M phases, W bins.  Coordinates in V s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import njit, types
from scipy.fft import fft, ifft, next_fast_len

from ....arrays import BoolArray, ComplexArray, FloatArray, real_parts
from ....device.force_law import FORCE_TYPE, LAWS_TYPE, Laws, force_pointer
from ..inband import Band

#: Coordinates and drives of the gyro, known when the loop is compiled.
AXES, DRIVES = 3, 2
#: Phases of a general law: those of third order are exact.
PHASES = 5
#: Points per bin of the band.  Products of three signals of the band that would fold need tones at both of its ends at once.
_POINTS_PER_BIN = 1.2
#: Envelope, relative to the largest, below which forces count as zero: the device has not reached its resonances yet.
_QUIET = 1e-2


@dataclass(frozen=True, eq=False)
class Grid:
    """Points over the record at which envelopes are taken: ``points`` n, and ``omega`` w0 [rad/s]."""

    band: Band
    points: int
    omega: float

    @property
    def middle(self) -> int:
        """Bin of w0."""
        return int(self.band.bins[self.band.bins.size // 2])

    @property
    def time_s(self) -> FloatArray:
        """Times of the points (n,) [s]."""
        return np.linspace(0.0, self.band.samples / self.band.sample_rate_hz, self.points, endpoint=False)

    def envelopes(self, spectrum: ComplexArray) -> ComplexArray:
        """a (.., n) of transforms (.., W)."""
        padded = np.zeros((*spectrum.shape[:-1], self.points), dtype=np.complex128)
        padded[..., self.band.bins - self.middle] = spectrum
        return np.asarray(ifft(padded, axis=-1) * (2.0 * self.points / self.band.samples))

    def spectra(self, envelope: ComplexArray) -> ComplexArray:
        """Transforms (.., W) of envelopes (.., n)."""
        whole = fft(envelope, axis=-1)[..., self.band.bins - self.middle]
        return np.asarray(whole * (self.band.samples / (2.0 * self.points)))


def grid_of(band: Band) -> Grid:
    """The grid of a band."""
    middle = band.frequency_hz[band.bins.size // 2]
    return Grid(band, next_fast_len(int(_POINTS_PER_BIN * band.bins.size) + 2), float(2.0 * np.pi * middle))


@dataclass(frozen=True, eq=False)
class Signals:
    """Envelopes of a device at the loud points of a grid.

    Parameters
    ----------
    grid, loud : its points, and which of them (n,) are loud.
    coordinates, velocities, drives : (n', 3) [V s], (n', 3) [V], (n', D) [V], complex.
    """

    grid: Grid
    loud: BoolArray
    coordinates: ComplexArray
    velocities: ComplexArray
    drives: ComplexArray

    @cached_property
    def time_s(self) -> FloatArray:
        """Times of the points (n',) [s]."""
        return self.grid.time_s[self.loud]

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Real and imaginary parts (2, n', ..) of coordinates, velocities and drives."""
        return real_parts(self.coordinates), real_parts(self.velocities), real_parts(self.drives)

    def whole(self, envelopes: Sequence[ComplexArray]) -> ComplexArray:
        """Envelopes (n', C) at all points, (K, C, n)."""
        out = np.zeros((len(envelopes), envelopes[0].shape[1], self.loud.size), dtype=np.complex128)
        out[:, :, self.loud] = np.swapaxes(np.stack(envelopes), 1, 2)
        return out


def signals_of(grid: Grid, coordinates: ComplexArray, velocities: ComplexArray, drives: ComplexArray) -> Signals:
    """Signals of envelopes (3, n), (3, n), (D, n)."""
    size = np.abs(velocities).sum(axis=0)
    loud = size > _QUIET * float(size.max())
    return Signals(grid, loud, *(np.ascontiguousarray(each.T[loud]) for each in (coordinates, velocities, drives)))


def _force_harmonics(
    force: Any,
    p: FloatArray,
    laws: Laws,
    time_s: FloatArray,
    coordinates: FloatArray,
    velocities: FloatArray,
    drives: FloatArray,
    steady: FloatArray,
    double: FloatArray,
    omega: float,
    phases: FloatArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (3, 2, n, 3): harmonics h = 0, 1, 2 of a force, real and imaginary parts, from ``phases`` (M,) [rad].

    coordinates, velocities (2, n, 3), drives (2, n, D): real and imaginary parts of envelopes; steady (n, 3) and double
    (2, n, 3): a motion at 0 and 2 w0 that is added.
    """
    q, qd, u, push = np.empty(AXES), np.empty(AXES), np.empty(DRIVES), np.empty(AXES)
    share = 2.0 / phases.size
    for m in range(phases.size):
        c, s, c2, s2 = np.cos(phases[m]), np.sin(phases[m]), np.cos(2.0 * phases[m]), np.sin(2.0 * phases[m])
        for n in range(time_s.size):
            for i in range(AXES):
                q[i] = coordinates[0, n, i] * c - coordinates[1, n, i] * s + steady[n, i]
                q[i] += double[0, n, i] * c2 - double[1, n, i] * s2
                qd[i] = velocities[0, n, i] * c - velocities[1, n, i] * s
                qd[i] -= 2.0 * omega * (double[0, n, i] * s2 + double[1, n, i] * c2)
                push[i] = 0.0
            for d in range(DRIVES):
                u[d] = drives[0, n, d] * c - drives[1, n, d] * s
            force(time_s[n], q, qd, u, p, laws, push)
            for i in range(AXES):
                f = push[i] * share
                out[0, 0, n, i] += f
                out[1, 0, n, i] += f * c
                out[1, 1, n, i] -= f * s
                out[2, 0, n, i] += f * c2
                out[2, 1, n, i] -= f * s2


@cache
def _compiled() -> Any:
    vector, matrix = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
    stack, harmonics = types.Array(types.float64, 3, "C"), types.Array(types.float64, 4, "C")
    arrays = (vector, stack, stack, stack, matrix, stack, types.float64, vector, harmonics)
    return njit(types.void(FORCE_TYPE, vector, LAWS_TYPE, *arrays), cache=True, error_model="numpy")(_force_harmonics)


#: A motion at 0 and 2 w0: steady part (n', 3) and amplitude (n', 3) [V s].
Deviation = tuple[FloatArray, ComplexArray]


@dataclass(frozen=True, eq=False)
class Law:
    """A force law along the signals of a device.

    Parameters
    ----------
    force, laws : see ``device.force_law``.
    signals : of the device.
    """

    force: Any
    laws: Laws
    signals: Signals

    def harmonics(
        self, p: FloatArray, phases: FloatArray, deviation: Deviation | None = None
    ) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """f_0 (n', 3) real, f_1 and f_2 (n', 3) [V/s] at parameters p (k,), from ``phases`` [rad]."""
        signals = self.signals
        points, axes = signals.coordinates.shape
        steady, double = deviation or (np.zeros((points, axes)), np.zeros((points, axes), dtype=np.complex128))
        out = np.zeros((3, 2, points, axes))
        _compiled()(
            force_pointer(self.force),
            np.ascontiguousarray(p, dtype=np.float64),
            self.laws,
            signals.time_s,
            *signals.parts,
            np.ascontiguousarray(steady),
            real_parts(double),
            signals.grid.omega,
            phases,
            out,
        )
        return out[0, 0], out[1, 0] + 1j * out[1, 1], out[2, 0] + 1j * out[2, 1]


def whole_turn() -> FloatArray:
    """Phases of a general law."""
    return np.linspace(0.0, 2.0 * np.pi, PHASES, endpoint=False)


def at_phases(envelope: ComplexArray) -> FloatArray:
    """Re{a e^{i phi_m}} (M n', C) of envelopes (n', C), phase by phase, at the phases of :func:`whole_turn`."""
    phi = whole_turn()[:, None, None]
    return np.asarray((np.cos(phi) * envelope.real - np.sin(phi) * envelope.imag).reshape(-1, envelope.shape[1]))


def first_harmonic(values: FloatArray) -> ComplexArray:
    """f_1 (n', C) of values (M n', C) at the phases of :func:`at_phases`."""
    waves = np.exp(-1j * whole_turn()) * (2.0 / PHASES)
    each = values.reshape(PHASES, -1)
    return np.asarray((waves.real @ each + 1j * (waves.imag @ each)).reshape(-1, values.shape[1]))
