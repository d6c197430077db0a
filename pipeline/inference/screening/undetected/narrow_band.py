"""Signals of a narrow band as envelopes, and the part of a nonlinear law that returns into the band.

    y(t) = Re{a(t) e^{i w0 t}},      a = Fourier sum over the bins of the band, w0 its middle

A law f of such signals is periodic in the phase w0 t at fixed envelopes,

    f = Re sum_h f_h(a) e^{i h w0 t},      f_h = (2/M) sum_m f(Re a e^{i phi_m}) e^{-i h phi_m},   phi_m = 2 pi m / M

so the part in the band is h = 1, at a thousand points instead of all samples.  This is an identity, not an average over a
period; harmonics from M - 1 upwards are folded.  Even laws give no h = 1.  Their h = 0 and 2 move the device quasi-statically,
and that motion mixes with the signal back into the band:

    d = K^-1 f_0 / 2 + Re{(K - 4 w0^2)^-1 f_2 e^{2 i w0 t}},      f_1(a, d)

Nonlinear laws count as zero where the device has not reached its resonances yet.

Shapes: n points over the record, n' of them used, 3 coordinates, D drives, S senses, M phases, W bins.  Coordinates in V s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numba import njit, types
from scipy.fft import fft, ifft, next_fast_len

from ....arrays import BoolArray, ComplexArray, FloatArray, IntArray, real_parts
from ....device.force_law import FORCE_TYPE, LAWS_TYPE, Laws, force_pointer
from ..inband import Band

#: Coordinates and drives of the gyro, known when the loop is compiled.
AXES, DRIVES = 3, 2
#: Laws that the compiled loop takes at once.
AT_ONCE = 8
#: Phases of a general law: those of third order are exact.
PHASES = 5
#: Points per bin of the band.  Products of three signals of the band that would fold need tones at both of its ends at once.
_POINTS_PER_BIN = 1.2
#: Envelope, relative to the largest, below which nonlinear forces count as zero: they grow as its square at least.
_QUIET = 5e-2


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
    """Envelopes of a device at points of a grid.

    Parameters
    ----------
    grid, kept : its points, and which of them (n,) the envelopes have.
    coordinates, velocities, drives : (n', 3) [V s], (n', 3) [V], (n', D) [V], complex.
    """

    grid: Grid
    kept: BoolArray
    coordinates: ComplexArray
    velocities: ComplexArray
    drives: ComplexArray

    @cached_property
    def time_s(self) -> FloatArray:
        """Times of the points (n',) [s]."""
        return self.grid.time_s[self.kept]

    @cached_property
    def parts(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Real and imaginary parts (2, n', ..) of coordinates, velocities and drives."""
        return real_parts(self.coordinates), real_parts(self.velocities), real_parts(self.drives)

    @cached_property
    def loud(self) -> Signals:
        """Those of all points at which nonlinear forces count."""
        size = np.abs(self.velocities).sum(axis=1)
        kept = size > _QUIET * float(size.max())
        return Signals(self.grid, kept, *(each[kept] for each in (self.coordinates, self.velocities, self.drives)))

    def whole(self, envelopes: Sequence[ComplexArray]) -> ComplexArray:
        """Envelopes (n', C) at all points of the grid, (K, C, n)."""
        out = np.zeros((len(envelopes), envelopes[0].shape[1], self.kept.size), dtype=np.complex128)
        out[:, :, self.kept] = np.swapaxes(np.stack(envelopes), 1, 2)
        return out


def signals_of(grid: Grid, coordinates: ComplexArray, velocities: ComplexArray, drives: ComplexArray) -> Signals:
    """Signals of envelopes (3, n), (3, n), (D, n)."""
    everywhere = np.ones(grid.points, dtype=np.bool_)
    return Signals(grid, everywhere, *(np.ascontiguousarray(each.T) for each in (coordinates, velocities, drives)))


def _force_harmonics(
    laws: Any,
    values: FloatArray,
    sizes: IntArray,
    conditions: Laws,
    time_s: FloatArray,
    coordinates: FloatArray,
    velocities: FloatArray,
    drives: FloatArray,
    steady: FloatArray,
    double: FloatArray,
    omega: float,
    phases: FloatArray,
    counts: IntArray,
    out: FloatArray,
) -> None:
    """Fill ``out`` (K, 3, 2, n', 3): harmonics h = 0, 1, 2 of K forces, real and imaginary parts.

    values (K, k), sizes (K,): parameters of each law; phases (K, M) [rad], counts (K,): phases of each; coordinates, velocities
    (2, n', 3), drives (2, n', D): real and imaginary parts of envelopes; steady (K, n', 3), double (K, 2, n', 3): a motion at 0
    and 2 w0 that is added, or (0, ..).
    """
    q, qd, u, push = np.empty(AXES), np.empty(AXES), np.empty(DRIVES), np.empty(AXES)
    for k in range(sizes.size):
        p, share = values[k, : sizes[k]], 2.0 / counts[k]
        for m in range(counts[k]):
            phi = phases[k, m]
            c, s, c2, s2 = np.cos(phi), np.sin(phi), np.cos(2.0 * phi), np.sin(2.0 * phi)
            for n in range(time_s.size):
                for i in range(AXES):
                    q[i] = coordinates[0, n, i] * c - coordinates[1, n, i] * s
                    qd[i] = velocities[0, n, i] * c - velocities[1, n, i] * s
                    push[i] = 0.0
                if steady.shape[0]:
                    for i in range(AXES):
                        q[i] += steady[k, n, i] + double[k, 0, n, i] * c2 - double[k, 1, n, i] * s2
                        qd[i] -= 2.0 * omega * (double[k, 0, n, i] * s2 + double[k, 1, n, i] * c2)
                for d in range(DRIVES):
                    u[d] = drives[0, n, d] * c - drives[1, n, d] * s
                laws[k](time_s[n], q, qd, u, p, conditions, push)
                for i in range(AXES):
                    f = push[i] * share
                    out[k, 0, 0, n, i] += f
                    out[k, 1, 0, n, i] += f * c
                    out[k, 1, 1, n, i] -= f * s
                    out[k, 2, 0, n, i] += f * c2
                    out[k, 2, 1, n, i] -= f * s2


@cache
def _compiled() -> Any:
    vector, matrix, integers = types.float64[::1], types.float64[:, ::1], types.int64[::1]
    stack, four, five = types.float64[:, :, ::1], types.float64[:, :, :, ::1], types.float64[:, :, :, :, ::1]
    what = (types.UniTuple(FORCE_TYPE, AT_ONCE), matrix, integers, LAWS_TYPE, vector, stack, stack, stack)
    arrays = (stack, four, types.float64, matrix, integers, five)
    return njit(types.void(*what, *arrays), cache=True, error_model="numpy")(_force_harmonics)


@dataclass(frozen=True, eq=False)
class ProbedLaw:
    """A force law at parameters p (k,), the phases (M,) [rad] at which it is taken, and a motion at 0 and 2 w0 that is added.

    The motion is its steady part (n', 3) and its amplitude (n', 3) at 2 w0 [V s].
    """

    force: Any
    p: FloatArray
    phases: FloatArray
    steady: FloatArray | None = None
    double: ComplexArray | None = None


def force_harmonics(laws: Sequence[ProbedLaw], conditions: Laws, signals: Signals) -> ComplexArray:
    """f_0, f_1, f_2 of each law along the signals of a device, (K, 3, n', 3) [V/s]; either all or none have an added motion."""
    found = [_at_once(laws[i : i + AT_ONCE], conditions, signals) for i in range(0, len(laws), AT_ONCE)]
    return np.concatenate(found) if found else np.zeros((0, 3, *signals.coordinates.shape), dtype=np.complex128)


def _at_once(laws: Sequence[ProbedLaw], conditions: Laws, signals: Signals) -> ComplexArray:
    count, points = len(laws), signals.coordinates.shape[0]
    sizes, counts = np.array([law.p.size for law in laws]), np.array([law.phases.size for law in laws])
    values, phases = np.zeros((count, sizes.max())), np.zeros((count, counts.max()))
    for k, law in enumerate(laws):
        values[k, : sizes[k]], phases[k, : counts[k]] = law.p, law.phases
    steady, double = np.zeros((0, points, AXES)), np.zeros((0, 2, points, AXES))
    if laws[0].steady is not None:
        steady = np.stack([np.asarray(law.steady) for law in laws])
        double = np.stack([real_parts(np.asarray(law.double)) for law in laws])
    out = np.zeros((count, 3, 2, points, AXES))
    pointers = [force_pointer(law.force) for law in laws]
    _compiled()(
        tuple(pointers + [pointers[0]] * (AT_ONCE - count)),
        values,
        sizes,
        conditions,
        signals.time_s,
        *signals.parts,
        steady,
        double,
        signals.grid.omega,
        phases,
        counts,
        out,
    )
    return np.asarray(out[:, :, 0] + 1j * out[:, :, 1])


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
