"""Signals of a narrow band as envelopes, and the part of a nonlinear law that returns into the band.

    y(t) = Re{a(t) e^{i w0 t}},      a = Fourier sum over the bins of the band, w0 its middle

A law f of such signals is periodic in the phase w0 t at fixed envelopes,

    f = Re sum_h f_h(a) e^{i h w0 t},      f_h = (2/M) sum_m f(Re a e^{i phi_m}) e^{-i h phi_m},   phi_m = 2 pi m / M

so the part in the band is h = 1, at a thousand points instead of all samples.  This is an identity, not an average over a
period; harmonics from M - 1 upwards are folded.  Even laws give no h = 1.  Their h = 0 and 2 move the device quasi-statically,
and that motion mixes with the signal back into the band:

    d = K^-1 f_0 / 2 + Re{(K - 4 w0^2)^-1 f_2 e^{2 i w0 t}},      f_1(a, d)

Nonlinear laws count as zero where the device has not reached its resonances yet.

Forces of first order are taken in single precision: its rounding, 6e-8, is far below the share of 1e-2 of the norm of a
signature that survives a fit.

Shapes: n points over the record, 3 coordinates, D drives, S senses, M phases, W bins.  Coordinates in V s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.fft import fft, ifft, next_fast_len

from ....arrays import AnyComplexArray, ComplexArray, FloatArray, RealArray
from ..inband import Band
from ..kept import kept_if_short

#: Points per bin of the band.  Products of three signals of the band that would fold need tones at both of its ends at once.
_POINTS_PER_BIN = 1.2
#: Envelope, relative to the largest, below which nonlinear forces count as zero: they grow as its square at least.
QUIET = 5e-2


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

    @cached_property
    def time_s(self) -> FloatArray:
        """Times of the points (n,) [s]."""
        return np.linspace(0.0, self.band.samples / self.band.sample_rate_hz, self.points, endpoint=False)

    @cached_property
    def _time_kernel(self) -> AnyComplexArray:
        """Transform (L,) of sum_n t_n e^{-2 pi i m n/N} / N [s] at the differences m of two bins, m < 0 at the end."""
        bins, samples = self.band.bins.size, self.band.samples
        m = np.arange(1, bins)
        kernel = np.zeros(next_fast_len(2 * bins - 1, real=True), dtype=np.complex128)
        kernel[0] = 0.5 * (samples - 1)
        kernel[m] = 1.0 / np.expm1(-2.0j * np.pi * m / samples)
        kernel[-m] = kernel[m].conj()
        return np.asarray(fft(kernel / self.band.sample_rate_hz), dtype=np.complex64)

    def over_time(self, spectrum: AnyComplexArray) -> AnyComplexArray:
        """Transforms (.., W) of t y(t) [s] from those of y (.., W), in single precision.

        The jump of t from the end of the record to its start needs more points than envelopes have.
        """
        product = fft(spectrum.astype(np.complex64, copy=False), self._time_kernel.size, axis=-1)
        product *= self._time_kernel
        return np.asarray(ifft(product, axis=-1)[..., : self.band.bins.size])

    def decays(self, exponents: ComplexArray) -> tuple[RealArray, RealArray]:
        """exp(x (T - t)) of exponents x (..) [1/s], T the end of the record, at the points as products of two short sequences.

        The factors (.., 2, C) of every F points and those (.., 2, F) of F points that follow each other, real parts first, in
        single precision; counted back from the end, because a strongly damped mode would overflow from the start.
        """
        step = self.band.samples / self.band.sample_rate_hz / self.points
        size = int(np.ceil(np.sqrt(self.points)))
        fine, coarse = (np.empty((*exponents.shape, size), dtype=np.complex128) for _ in range(2))
        fine[:] = np.exp(exponents * step)[..., None]
        np.cumprod(fine, axis=-1, out=fine)
        coarse[..., 0], coarse[..., 1:] = 1.0, fine[..., -1:]
        np.cumprod(coarse, axis=-1, out=coarse)
        return single_parts(coarse[..., ::-1]), single_parts(fine[..., ::-1])

    def envelopes(self, spectrum: AnyComplexArray) -> AnyComplexArray:
        """a (.., n) of transforms (.., W), both in units of :attr:`bin_scale` and of one precision."""
        padded = np.zeros((*spectrum.shape[:-1], self.points), dtype=spectrum.dtype)
        padded[..., self.points - self.below :] = spectrum[..., : self.below]
        padded[..., : spectrum.shape[-1] - self.below] = spectrum[..., self.below :]
        return np.asarray(ifft(padded, axis=-1, overwrite_x=True))

    @property
    def below(self) -> int:
        """Bins of the band below w0."""
        return self.middle - int(self.band.bins[0])

    def transforms(self, envelope: AnyComplexArray, overwrite: bool = False) -> AnyComplexArray:
        """Transforms (.., n) of envelopes (.., n), the bin of w0 first, those below it at the end.

        ``overwrite``: in the memory of the envelopes.
        """
        return np.asarray(fft(envelope, axis=-1, overwrite_x=overwrite))

    def spectra(self, envelope: AnyComplexArray) -> AnyComplexArray:
        """Transforms (.., W) of envelopes (.., n), in units of :attr:`bin_scale` and of their precision."""
        whole, above = self.transforms(envelope), self.band.bins.size - self.below
        return np.concatenate([whole[..., self.points - self.below :], whole[..., :above]], axis=-1)

    @property
    def bin_scale(self) -> float:
        """What turns :meth:`spectra` into transforms [V]."""
        return self.band.samples / (2.0 * self.points)


@kept_if_short(4)
def grid_of(band: Band) -> Grid:
    """The grid of a band."""
    middle = band.frequency_hz[band.bins.size // 2]
    return Grid(band, next_fast_len(int(_POINTS_PER_BIN * band.bins.size) + 2), float(2.0 * np.pi * middle))


@dataclass(frozen=True)
class Phases:
    """M = ``count`` phases over a ``turn`` [cycles] of w0: those of whole turns give all harmonics below M."""

    count: int
    turn: float


#: Phases of a general law: those of third order are exact.
WHOLE_TURN = Phases(5, 1.0)


@cache
def waves(phases: Phases, orders: tuple[int, ...], single: bool) -> RealArray:
    """cos(h phi_m), then -sin(h phi_m), of each of the orders h, (2 len(orders), M), in ``single`` or double precision."""
    angles = np.array(orders)[:, None] * np.linspace(0.0, 2.0 * np.pi * phases.turn, phases.count, endpoint=False)
    found = np.stack([np.cos(angles), -np.sin(angles)], axis=1).reshape(-1, phases.count)
    return np.asarray(found, dtype=np.float32 if single else np.float64)


@dataclass(frozen=True, eq=False)
class Signals:
    """Envelopes of a device at the points of a grid, in single precision.

    Parameters
    ----------
    grid : the grid.
    envelopes : of coordinates, velocities and drives (3 + 3 + D, n) [V s, V, V].
    """

    grid: Grid
    envelopes: AnyComplexArray

    @property
    def coordinates(self) -> AnyComplexArray:
        """(3, n) [V s]."""
        return self.envelopes[:3]

    @property
    def velocities(self) -> AnyComplexArray:
        """(3, n) [V]."""
        return self.envelopes[3:6]


def _is_single(values: RealArray | AnyComplexArray) -> bool:
    return values.dtype in (np.float32, np.complex64)


def _parts(envelope: AnyComplexArray) -> RealArray:
    """Real and imaginary parts (.., 2, n) of envelopes (.., n)."""
    return np.stack([envelope.real, envelope.imag], axis=-2)


def single_parts(values: ComplexArray) -> RealArray:
    """Real and imaginary parts (.., 2, n) of values (.., n), in single precision."""
    return _parts(values).astype(np.float32)


def at_phases(envelope: AnyComplexArray, phases: Phases) -> RealArray:
    """Re{a e^{i phi_m}} (.., M n) of envelopes a (.., n), phase by phase, in their precision."""
    turns = waves(phases, (1,), _is_single(envelope))
    return np.asarray(turns.T @ _parts(envelope)).reshape(*envelope.shape[:-1], -1)


def harmonics(values: RealArray, phases: Phases, *orders: int) -> list[AnyComplexArray]:
    """f_h (.., n) of values (.., M n), phase by phase, for each of the ``orders`` h, in their precision."""
    single = _is_single(values)
    parts = (waves(phases, orders, single) * (2.0 / phases.count)) @ values.reshape(
        *values.shape[:-1], phases.count, -1
    )
    shape = (len(orders), *values.shape[:-1], parts.shape[-1])
    out = np.empty(shape, dtype=np.complex64 if single else np.complex128)
    for i, own in enumerate(out):
        own.real, own.imag = parts[..., 2 * i, :], parts[..., 2 * i + 1, :]
    return list(out)
