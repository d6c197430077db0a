"""Signals of a narrow band as envelopes, and the part of a nonlinear law that returns into the band.

    y(t) = Re{a(t) e^{i w0 t}},      a = Fourier sum over the bins of the band, w0 its middle

A law f of such signals is periodic in the phase w0 t at fixed envelopes,

    f = Re sum_h f_h(a) e^{i h w0 t},      f_h = (2/M) sum_m f(Re a e^{i phi_m}) e^{-i h phi_m},   phi_m = 2 pi m / M

so the part in the band is h = 1, at a thousand points instead of all samples.  This is an identity, not an average over a
period; harmonics from M - 1 upwards are folded.  Half a turn suffices for a law that is odd or even, two phases for a linear one.
Even laws give no h = 1.  Their h = 0 and 2 move the device quasi-statically, and that motion mixes with the signal back into the
band:

    d = K^-1 f_0 / 2 + Re{(K - 4 w0^2)^-1 f_2 e^{2 i w0 t}},      f_1(a, d)

Shapes: n points over the record, 3 coordinates, D drives, S senses, M phases, W bins.  Coordinates in V s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit, types
from scipy.fft import fft, ifft, next_fast_len

from ....arrays import BoolArray, ComplexArray, FloatArray, real_parts
from ....device.force_law import FORCE_TYPE, LAWS_TYPE, Laws, compiled_force
from ....threads import once
from ..inband import Band

#: Phases of a general law, and of half a turn for an odd law: |x| x is then right to 1 % (its seventh harmonic is folded).
PHASES, _HALF = 6, 4
#: Points per bin of the band.  Products of three signals of the band that would fold need tones at both of its ends at once.
_POINTS_PER_BIN = 1.4
#: Envelope, relative to the largest, below which forces count as zero: the device has not reached its resonances yet.
_QUIET = 5e-3
#: Relative size of a part of a law that counts as rounding.
_ROUNDING = 1e-9
#: Every so many points a law is tried to find its parity.
_SPARSE = 16


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
    """Envelopes of a device on a grid: coordinates and velocities (n, 3), drives (n, D) [V], all complex; quiet points (n,)."""

    grid: Grid
    coordinates: ComplexArray
    velocities: ComplexArray
    drives: ComplexArray
    loud: BoolArray


def signals_of(grid: Grid, coordinates: ComplexArray, velocities: ComplexArray, drives: ComplexArray) -> Signals:
    """Signals of envelopes (3, n), (3, n), (D, n)."""
    size = np.abs(velocities).sum(axis=0)
    return Signals(
        grid,
        np.ascontiguousarray(coordinates.T),
        np.ascontiguousarray(velocities.T),
        np.ascontiguousarray(drives.T),
        size > _QUIET * float(size.max()),
    )


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
    points, axes = coordinates.shape[1:]
    q, qd, u = np.empty(axes), np.empty(axes), np.empty(drives.shape[2])
    push = np.empty(axes)
    for m in range(phases.size):
        c, s, c2, s2 = np.cos(phases[m]), np.sin(phases[m]), np.cos(2.0 * phases[m]), np.sin(2.0 * phases[m])
        for n in range(points):
            for i in range(axes):
                q[i] = coordinates[0, n, i] * c - coordinates[1, n, i] * s + steady[n, i]
                q[i] += double[0, n, i] * c2 - double[1, n, i] * s2
                qd[i] = velocities[0, n, i] * c - velocities[1, n, i] * s
                qd[i] -= 2.0 * omega * (double[0, n, i] * s2 + double[1, n, i] * c2)
                push[i] = 0.0
            for d in range(u.size):
                u[d] = drives[0, n, d] * c - drives[1, n, d] * s
            force(time_s[n], q, qd, u, p, laws, push)
            for i in range(axes):
                f = push[i] * (2.0 / phases.size)
                out[0, 0, n, i] += f
                out[1, 0, n, i] += f * c
                out[1, 1, n, i] -= f * s
                out[2, 0, n, i] += f * c2
                out[2, 1, n, i] -= f * s2


@once
def _compiled(axes: int) -> Any:
    vector, matrix = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
    stack, harmonics = types.Array(types.float64, 3, "C"), types.Array(types.float64, 4, "C")
    arrays = (vector, stack, stack, stack, matrix, stack, types.float64, vector, harmonics)
    return njit(types.void(FORCE_TYPE, vector, LAWS_TYPE, *arrays), cache=True, error_model="numpy")(_force_harmonics)


#: A motion at 0 and 2 w0: steady part (n, 3) and amplitude (n, 3) [V s].
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
        """f_0 (n, 3) real, f_1 and f_2 (n, 3) [V/s] at parameters p (k,), from ``phases`` [rad]; zero where it is quiet."""
        signals, kept = self.signals, self.signals.loud
        points, axes = int(kept.sum()), signals.coordinates.shape[1]
        if deviation is None:
            steady, double = np.zeros((points, axes)), np.zeros((2, points, axes))
        else:
            steady, double = deviation[0][kept], real_parts(deviation[1][kept])
        out = np.zeros((3, 2, points, axes))
        _compiled(axes)(
            compiled_force(self.force),
            np.ascontiguousarray(p, dtype=np.float64),
            self.laws,
            signals.grid.time_s[kept],
            real_parts(signals.coordinates[kept]),
            real_parts(signals.velocities[kept]),
            real_parts(signals.drives[kept]),
            steady,
            double,
            signals.grid.omega,
            phases,
            out,
        )
        whole = np.zeros((3, kept.size, axes), dtype=np.complex128)
        whole[:, kept] = out[:, 0] + 1j * out[:, 1]
        return whole[0].real, whole[1], whole[2]

    def sparse(self) -> Law:
        """The law at few of the points."""
        s = self.signals
        kept = np.zeros_like(s.loud)
        kept[np.flatnonzero(s.loud)[::_SPARSE]] = True
        return replace(self, signals=replace(s, loud=kept))

    def phases(self, p: FloatArray) -> FloatArray:
        """The phases that the law needs at p (k,): half a turn if it is odd or even, two if it is linear."""
        few = self.sparse()
        at = [few.harmonics(p, np.array([angle]))[0] for angle in (0.3, 0.3 + np.pi)]
        size = _ROUNDING * float(np.linalg.norm(at[0]))
        if np.linalg.norm(at[0] + at[1]) > size and np.linalg.norm(at[0] - at[1]) > size:
            return np.asarray(2.0 * np.pi * np.arange(PHASES) / PHASES)
        twice = replace(few, signals=_scaled(few.signals, 2.0)).harmonics(p, np.array([0.3]))[0]
        count = 2 if np.linalg.norm(twice - 2.0 * at[0]) <= size else _HALF
        return np.asarray(np.pi * np.arange(count) / count)


def _scaled(signals: Signals, factor: float) -> Signals:
    return replace(
        signals,
        coordinates=factor * signals.coordinates,
        velocities=factor * signals.velocities,
        drives=factor * signals.drives,
    )


def whole_turn() -> FloatArray:
    """Phases of a general law."""
    return np.asarray(2.0 * np.pi * np.arange(PHASES) / PHASES)


def at_phases(envelope: ComplexArray) -> FloatArray:
    """Re{a e^{i phi_m}} (n M, C) of envelopes (n, C), point by point, at the phases of :func:`whole_turn`."""
    n, channels = envelope.shape
    waves = np.exp(1j * whole_turn())
    return np.asarray((envelope[:, None, :] * waves[:, None]).real.reshape(n * PHASES, channels))


def first_harmonic(values: FloatArray, points: int) -> ComplexArray:
    """f_1 (n, C) of values (n M, C) at the phases of :func:`at_phases`."""
    each = np.moveaxis(values.reshape(points, PHASES, -1), 1, 2)
    return np.asarray(each @ np.exp(-1j * whole_turn()) * (2.0 / PHASES))
