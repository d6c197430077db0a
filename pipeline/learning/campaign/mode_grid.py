"""The grid of an additional mode: frequencies, damping ratios, and the spectra of its response and of its decay.

    H(s) = w^(1 - m) s^m / (s^2 + 2 zeta w s + w^2)         pick-offs of displacement, velocity, acceleration: m = 0, 1, 2

Shapes: R records, F bins, D drives, W waveforms, P poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.fft import fft

from ...arrays import ComplexArray, FloatArray, real_parts
from ...device.plant import SENSES, Sense
from ...device.readout import plain_readout
from ...experiment.antialias import filter_poles
from ...experiment.forward.drive_groups import DriveGroup, drive_groups_of
from ...experiment.forward.modal_bank import hold_gains
from ...experiment.instrument import Instrument
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign
from ...inference.general.starts import excited_band
from ...inference.general.whitening import colour_of
from .rows import USABLE

#: Damping ratios of wide modes, which are scanned at all frequencies, and of narrow ones, which only the driven band shows.
_ZETAS = (1e-2, 1.5e-3)
#: Share of the peak down to which the response of a mode is kept.
_KEPT = 2e-2
#: Neighbouring grid points that are computed and scored together, because they share most of their bins.
TOGETHER = 4


@dataclass(frozen=True, eq=False)
class ScanPoint:
    """A mode of the grid: frequency, damping ratio, first bin, response (W, bins) to each waveform, and decay (2, bins).

    Both are scaled as the rows.  The decay starts from a unit of each of two states; (0, bins) if no record needs it.
    """

    f_hz: float
    zeta: float
    first: int
    response: ComplexArray
    decay: ComplexArray


@dataclass(frozen=True, eq=False)
class Scan:
    """The grid for one drive group: places of its records, gains (R, D, W) of the waveforms, records in motion, grid points.

    ``moving`` are the indices, in the group, of the records that do not start at rest.
    """

    places: tuple[int, ...]
    gains: FloatArray
    moving: tuple[int, ...]
    points: tuple[ScanPoint, ...]

    @property
    def mixing(self) -> FloatArray:
        """(W, D R): the amplitude of each waveform in each drive of each record, from ``gains``."""
        records, drives, waveforms = self.gains.shape
        return np.asarray(self.gains.transpose(2, 1, 0).reshape(waveforms, drives * records))


def mode_scans(
    campaign: Campaign, bins: Sequence[int], low_hz: float, top_hz: float, sense: Sense, noise: NoiseLevel
) -> tuple[Scan, ...]:
    """The scan of each drive group of the fit records.

    Parameters
    ----------
    campaign : its fit records.
    bins : number F of bins above zero of each fit record.
    low_hz, top_hz : lowest and highest frequency of a mode [Hz]; nearer to Nyquist than ``USABLE`` of it, a mode cannot be
        distinguished from its alias.
    sense : what the pick-offs sense.
    noise : its colour, averaged over the channels, weights the bins.
    """
    records = campaign.with_role("fit")
    groups = drive_groups_of(records, campaign.instrument, campaign.angular_gain)
    top_hz = min(top_hz, USABLE * 0.5 * records[0].sample_rate_hz)
    driven_hz = excited_band(records)
    wide, narrow = _ZETAS
    grid = [*_grid(wide, low_hz, top_hz), *_grid(narrow, max(low_hz, driven_hz[0]), min(driven_hz[1], top_hz))]
    m, instrument = SENSES.index(sense), campaign.instrument
    moving = [tuple(k for k, i in enumerate(places) if not records[i].at_rest) for places, _ in groups]
    return tuple(
        _scan(places, own, group, instrument, bins[places[0]], grid, m, noise)
        for (places, group), own in zip(groups, moving)
    )


def _grid(zeta: float, low_hz: float, high_hz: float) -> list[tuple[float, float]]:
    """(f [Hz], zeta) from ``low_hz`` to ``high_hz``, neighbours a line width, 2 zeta f, apart."""
    count = int(np.log(high_hz / low_hz) / (2.0 * zeta)) + 1 if high_hz > low_hz else 0
    return [(low_hz * (1.0 + 2.0 * zeta) ** k, zeta) for k in range(count)]


def _scan(
    places: tuple[int, ...],
    moving: tuple[int, ...],
    group: DriveGroup,
    instrument: Instrument,
    bins: int,
    grid: Sequence[tuple[float, float]],
    m: int,
    noise: NoiseLevel,
) -> Scan:
    """The response of every mode of ``grid`` in the first ``bins`` bins above zero of a drive group.

    ``m`` is the derivative of the motion that the pick-offs sense.
    """
    samples = group.drives[0].shape[0]
    omega = 2.0 * np.pi * np.arange(1, bins + 1) * group.sample_rate_hz / samples
    transfer = np.ones(bins, dtype=np.complex128)
    if instrument.antialias is not None:
        transfer = plain_readout(*filter_poles(instrument.antialias), 1, 1).response(1j * omega)[:, 0, 0]
    colour = colour_of(noise, samples, group.sample_rate_hz)
    scale = (
        np.full(bins, np.sqrt(2.0 / samples))
        if colour is None
        else np.sqrt(2.0 / samples) * colour[1 : bins + 1].mean(axis=1)
    )
    transfer = transfer * scale
    points: list[ScanPoint] = []
    w, zeta = 2.0 * np.pi * np.array([f for f, _ in grid]), np.array([z for _, z in grid])
    poles = w * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    residues = w ** (1 - m) * poles**m / (2j * poles.imag)
    z, now, following = hold_gains(poles, group.clock.step_s, group.clock.hold)
    # The samples are every ``stride``-th step of the clock, so their spectrum is the mean of its aliases.
    aliases = np.arange(group.clock.stride)[:, None] * samples + np.arange(1, bins + 1)
    phasor = np.exp(2j * np.pi * aliases / group.waveforms.shape[1])
    drives = [fft(waveform)[aliases] for waveform in group.waveforms]
    held = real_parts(z), real_parts(now), real_parts(following)
    ends = [re + 1j * im for re, im in (_end_states(*held, waveform) for waveform in group.waveforms)]
    # A few at a time, because most of a response is below what is kept.
    responses = np.empty((TOGETHER, len(ends), bins), dtype=np.complex128)
    for first in range(0, w.size, TOGETHER):
        of = slice(first, first + TOGETHER)
        for k, (end, drive) in enumerate(zip(ends, drives)):
            v0 = group.waveforms[k][0]
            out = responses[: z[of].size, k]
            _respond(z[of], now[of], following[of], end[of], residues[of], phasor, drive, v0, transfer, out)
            if m == 2:
                # s^2 / (..) = 1 - (..): the part of an acceleration that follows the drive at once.
                out += np.multiply.outer(1.0 / w[of], drive.mean(axis=0) * transfer)
        for (f, damping), response in zip(grid[of], responses):
            size = np.max(np.abs(response), axis=0, initial=0.0)
            # The response of a displacement below the mode, and of an acceleration above it, does not fall off.
            strong = np.flatnonzero(size > (_KEPT if m == 1 else 0.0) * size.max())
            begin, end_bin = (int(strong[0]), int(strong[-1]) + 1) if strong.size else (0, 1)
            kept = slice(begin, end_bin)
            decay = (
                _decay(f, damping, samples, group.sample_rate_hz, kept) if moving else np.zeros((0, end_bin - begin))
            )
            points.append(ScanPoint(f, damping, begin, response[:, kept].copy(), decay * scale[kept]))
    return Scan(places, group.gains, moving, tuple(points))


def _decay(f_hz: float, zeta: float, samples: int, rate_hz: float, bins: slice) -> ComplexArray:
    """Spectra (2, bins) of Re z^n and Im z^n, z = exp(p / f_s), at the bins above zero; scaled to the energy of one sample."""
    w = 2.0 * np.pi * f_hz
    z = np.exp(w * complex(-zeta, np.sqrt(1.0 - zeta**2)) / rate_hz)
    back = np.exp(-2j * np.pi * np.arange(bins.start + 1, bins.stop + 1) / samples)
    forward, mirrored = ((1.0 - v**samples) / (1.0 - v * back) for v in (z, np.conj(z)))
    return np.stack([0.5 * (forward + mirrored), -0.5j * (forward - mirrored)])


_FAST = {"contract", "reassoc", "nsz"}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _end_states(z: FloatArray, now: FloatArray, following: FloatArray, waveform: FloatArray) -> FloatArray:
    """State (2, P) one step after the end of a waveform that x[n + 1] = z x[n] + now v[n] + following v[n + 1] starts at rest.

    Real parts come before imaginary ones; v = 0 after the end.
    """
    x = np.zeros((2, z.shape[1]))
    for n in range(waveform.size):
        v, ahead = waveform[n], waveform[n + 1] if n + 1 < waveform.size else 0.0
        for p in range(z.shape[1]):
            re, im = x[0, p], x[1, p]
            x[0, p] = z[0, p] * re - z[1, p] * im + now[0, p] * v + following[0, p] * ahead
            x[1, p] = z[0, p] * im + z[1, p] * re + now[1, p] * v + following[1, p] * ahead
    return x


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _respond(
    z: ComplexArray,
    now: ComplexArray,
    following: ComplexArray,
    ends: ComplexArray,
    residues: ComplexArray,
    phasor: ComplexArray,
    drive: ComplexArray,
    first_v: float,
    transfer: ComplexArray,
    out: ComplexArray,
) -> None:
    """Writes the spectrum (P, F) of 2 Re(residue x) to ``out``, for x of ``_end_states``.

        X (e^iw - z) = now V + e^iw (following (V - v[0]) - x[N])

    phasor, drive: e^iw and V at the aliases (m, F) of the bins; transfer (F,): factor of each bin.
    """
    aliases, bins = phasor.shape
    for p in range(z.size):
        # Both poles of the pair over one real denominator.
        a, b, c = residues[p] * now[p], residues[p] * following[p], residues[p] * ends[p]
        back = np.conj(z[p])
        a1, b1, c1 = 2.0 * a.real, 2.0 * b.real, 2.0 * c.real
        a0, b0, c0 = 2.0 * (a * back).real, 2.0 * (b * back).real, 2.0 * (c * back).real
        d1, d0 = 2.0 * z[p].real, (z[p] * back).real
        for f in range(bins):
            total = 0.0 + 0.0j
            for m in range(aliases):
                e, v = phasor[m, f], drive[m, f]
                rise = e * (v - first_v)
                above = (a1 * e - a0) * v + (b1 * e - b0) * rise - (c1 * e - c0) * e
                below = e * e - d1 * e + d0
                total += above * np.conj(below) / (below.real * below.real + below.imag * below.imag)
            out[p, f] = total * transfer[f] / aliases
