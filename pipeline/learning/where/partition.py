"""How the residual of a campaign is partitioned: areas of the time-frequency plane, fine bands, levels of motion, lines.

Every cell of the time-frequency plane of a record belongs to exactly one area.  Kinds of areas:

    resonance   a band around one or more modes
    harmonic    k times the instantaneous drive frequency (k = 1: the drive itself), and the sums of k resonances
    broadband   the rest, in bands

A partition is made once per campaign, from its first fit; all models are compared on the same partition.

Shapes: N samples, S senses, D drives, K blocks of M bins, B short blocks of L samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise

import numpy as np
from scipy.fft import rfft

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Spectrum
from ...criticism.regions import lines_in, pooled_spectra
from ...experiment.noise.time_frequency import bin_frequencies, block_size, cell_variances, lapped
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit
from ...inference.general.free_disturbances import SPREAD_BINS
from ...inference.general.resonances import HALF_WIDTHS, resonances_of

Band = tuple[float, float]

MAX_ORDER = 5
LEVELS = 6
#: Width of a fine band in units of the sample rate (25 Hz at 10 kHz).
_FINE = 0.0025


@dataclass(frozen=True)
class Area:
    """An area of the time-frequency plane: kind, band [Hz] that contains it, order of the harmonic (0: not a harmonic)."""

    kind: str
    band_hz: Band
    order: int = 0


@dataclass(frozen=True, eq=False)
class RecordPartition:
    """The partition of one record.

    Parameters
    ----------
    sample_rate_hz : of the record [Hz].
    size : M, bins of a block.
    areas : of the time-frequency plane.
    area_of_cell : (K, M) index of the area of each cell.
    area_dof : degrees of freedom of each area, one per area.
    bands : fine bands [Hz].
    band_of_bin : (M,) index of the fine band of each bin.
    band_dof : degrees of freedom of each fine band.
    level_of_block : (B, S) level of the motion in each short block, 0 .. LEVELS - 1.
    level_edges_v : (LEVELS + 1, S) edges of the levels [V, rms].
    response_hz : bands [Hz] in which a narrow peak is a response of the device, not a line.
    """

    sample_rate_hz: float
    size: int
    areas: tuple[Area, ...]
    area_of_cell: IntArray
    area_dof: FloatArray
    bands: tuple[Band, ...]
    band_of_bin: IntArray
    band_dof: FloatArray
    level_of_block: IntArray
    level_edges_v: FloatArray
    response_hz: tuple[Band, ...]


@dataclass(frozen=True, eq=False)
class CampaignPartition:
    """The partition of each record by name, and the spectral lines [Hz] of the residual."""

    records: Mapping[str, RecordPartition]
    lines_hz: tuple[float, ...]


def campaign_partition(fit: CampaignFit, records: Mapping[str, RecordPartition]) -> CampaignPartition:
    """Adds the lines [Hz] that the residual of ``fit`` shows in a fitted record or in the sum over all of them."""
    fitted = fit.of_role("fit")
    spectra = residual_spectra(fit, records)
    found: list[float] = []
    for mine, spectrum in zip(fitted, spectra):
        found += lines_in(spectrum, records[mine.name].response_hz)
    responses = [band for mine in fitted for band in records[mine.name].response_hz]
    for spectrum in pooled_spectra(spectra):
        found += lines_in(spectrum, responses)
    widths = (records[mine.name].sample_rate_hz / mine.residual.shape[0] for mine in fitted)
    return CampaignPartition(records, tuple(_merged(found, 1.5 * max(widths, default=0.0), _mains_hz(fit))))


def residual_spectra(fit: CampaignFit, records: Mapping[str, RecordPartition]) -> list[Spectrum]:
    """Residual energy by frequency [Hz] of each fitted record, with a Hann window and summed over channels."""
    return [_spectrum(mine.residual, records[mine.name].sample_rate_hz) for mine in fit.of_role("fit")]


def _spectrum(residual: FloatArray, sample_rate_hz: float) -> Spectrum:
    """Energy by frequency of a whitened residual (N, S), summed over its channels."""
    samples, senses = residual.shape
    # With a Hann window a line between two bins is three bins wide.
    window = np.hanning(samples)
    chi2 = np.sum(np.abs(rfft(residual.T * window, axis=-1)) ** 2, axis=0) / (0.5 * np.sum(window**2))
    # The bins at both ends have fewer degrees of freedom.
    inside = slice(SPREAD_BINS, chi2.size - SPREAD_BINS)
    return Spectrum(np.arange(chi2.size)[inside] * sample_rate_hz / samples, chi2[inside], 2 * senses)


def _mains_hz(fit: CampaignFit) -> tuple[float, ...]:
    """Mains frequencies [Hz] that effects of the library declare."""
    declared = [
        (effect.mains_frequency, parameter)
        for effect in fit.model.library.values()
        for parameter in effect.parameters
        if effect.mains_frequency
    ]
    return tuple(hz for name, parameter in declared if parameter.name == name for hz in parameter.grid)


def _merged(frequencies_hz: Sequence[float], resolution_hz: float, mains_hz: Sequence[float]) -> list[float]:
    """Frequencies [Hz], those closer than the resolution merged; the exact harmonic of the mains where one is as close."""
    out: list[float] = []
    for f in sorted(frequencies_hz):
        exact = next((k * m for m in mains_hz if abs(f - (k := round(f / m)) * m) <= resolution_hz and k > 0), f)
        if not out or exact - out[-1] > resolution_hz:
            out.append(exact)
    return out


def record_partitions(campaign: Campaign, fit: CampaignFit) -> dict[str, RecordPartition]:
    """The partition of each record in ``fit`` by name, from its resonances [Hz] and its predicted motion (N, S) [V]."""
    records: Mapping[str, Record] = {record.name: record for record in campaign.records}
    rms = {mine.name: np.sqrt(np.mean(short_blocks(mine.predicted_v) ** 2, axis=1)) for mine in fit.records}
    largest = np.maximum(np.max([level.max(axis=0) for level in rms.values()], axis=0), 1e-300)
    resonances = resonances_of(fit.values)
    return {name: _record_partition(records[name], level, largest, resonances) for name, level in rms.items()}


def without_lines(
    residual: FloatArray, sample_rate_hz: float, frequencies_hz: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    """The residual (N, S) without sinusoids of these frequencies, and the energy (lines, S) of each, in sequence."""
    samples = residual.shape[0]
    t = np.arange(samples) / sample_rate_hz
    left, energies = residual, np.zeros((len(frequencies_hz), residual.shape[1]))
    basis = np.zeros((samples, 0))
    for k, f in enumerate(frequencies_hz):
        pair = np.stack([np.cos(2.0 * np.pi * f * t), np.sin(2.0 * np.pi * f * t)], axis=1)
        pair, _ = np.linalg.qr(pair - basis @ (basis.T @ pair))
        basis = np.concatenate([basis, pair], axis=1)
        amplitudes = pair.T @ left
        left = left - pair @ amplitudes
        energies[k] = np.sum(amplitudes**2, axis=0)
    return left, energies


def short_blocks(y: FloatArray) -> FloatArray:
    """(N, S) -> (B, L, S): about 500 blocks of equal length; samples left over at the end are dropped."""
    length = max(y.shape[0] // 500, 4)
    count = y.shape[0] // length
    return y[: count * length].reshape(count, length, y.shape[1])


def _record_partition(
    record: Record, rms_v: FloatArray, largest_v: FloatArray, resonances: Sequence[Band]
) -> RecordPartition:
    samples, rate = record.drive_v.shape[0], record.sample_rate_hz
    size = block_size(samples)
    frequency, half_width = bin_frequencies(size, rate), 0.5 * SPREAD_BINS * rate / size
    variances = cell_variances(samples, size)
    inside = [(f, max(half_width, 2.0 * HALF_WIDTHS * width)) for f, width in resonances if f < 0.5 * rate]
    resonant = _resonant_bands(inside)
    drives, driven = _drive_frequencies(record, size)
    edges = sorted(
        {0.0, *driven, *(e for band in resonant for e in band), *_octaves(driven[1], 0.4 * rate), 0.5 * rate}
    )
    areas = [Area("broadband", band) for band in pairwise(edges)]
    cell = np.tile(np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, len(areas) - 1), (variances.size, 1))
    for order in range(MAX_ORDER, 0, -1):
        mask = np.zeros(cell.shape, dtype=bool)
        for harmonic_hz in _harmonics(drives, [f for f, _ in inside], order):
            mask |= np.abs(frequency - harmonic_hz[:, None]) <= half_width
        if mask.any():
            span = frequency[mask.any(axis=0)]
            cell[mask] = len(areas)
            areas.append(Area("harmonic", (float(span[0]), float(span[-1])), order))
    for low, high in resonant:
        cell[:, (frequency >= low) & (frequency <= high)] = len(areas)
        areas.append(Area("resonance", (low, high)))
    weights = np.repeat(variances, size)
    bands, band = _fine_bands(frequency, rate)
    steps = np.floor(LEVELS * (1.0 + np.log10(np.maximum(rms_v / largest_v, 1e-3)) / 3.0))
    # Without a sweep the whole driven band responds at any time.
    unswept = [] if np.isfinite(drives).any() else [driven]
    return RecordPartition(
        rate,
        size,
        tuple(areas),
        cell,
        np.asarray(np.bincount(cell.reshape(-1), weights, len(areas)), dtype=np.float64),
        bands,
        band,
        np.asarray(np.bincount(band, minlength=len(bands)) * variances.sum(), dtype=np.float64),
        np.clip(steps, 0, LEVELS - 1).astype(np.int64),
        np.geomspace(1e-3 * largest_v, largest_v, LEVELS + 1),
        (*resonant, *unswept, *_sum_bands([f for f, _ in inside])),
    )


def _resonant_bands(resonances: Sequence[Band]) -> list[Band]:
    """Bands [Hz] around resonances (centre, half-width); close resonances share a band, bands do not overlap."""
    found: list[list[float]] = []
    for f, half in resonances:
        if found and f - found[-1][1] < half:
            found[-1][1:] = [f, max(found[-1][2], half)]
        else:
            found.append([f, f, half])
    bands = [[max(first - half, 0.0), last + half] for first, last, half in found]
    for left, right in pairwise(bands):
        if left[1] > right[0]:
            left[1] = right[0] = 0.5 * (left[1] + right[0])
    return [(float(low), float(high)) for low, high in bands]


def _octaves(high_hz: float, below_hz: float) -> list[float]:
    """2 high, 4 high, ... below a limit [Hz]."""
    out, edge = [], 2.0 * high_hz
    while 0.0 < edge < below_hz:
        out.append(edge)
        edge *= 2.0
    return out


def _fine_bands(frequency: FloatArray, rate: float) -> tuple[tuple[Band, ...], IntArray]:
    """The fine bands [Hz] that contain at least one bin, and the band of each bin (M,)."""
    width = 2.0 * float(frequency[0])
    edges = np.arange(0.0, 0.5, max(_FINE, width / rate)) * rate
    band = np.searchsorted(edges, frequency, side="right") - 1
    kept, band = np.unique(band, return_inverse=True)
    ends = [float(edge) for edge in edges[kept]]
    return tuple(zip(ends, [*ends[1:], 0.5 * rate])), np.asarray(band, dtype=np.int64)


def _drive_frequencies(record: Record, size: int) -> tuple[FloatArray, Band]:
    """(D, K) instantaneous frequency [Hz] of the drives, nan where not sinusoidal; band [Hz] of 99 % of their energy."""
    energy = lapped(record.drive_v, size) ** 2
    frequency = bin_frequencies(size, record.sample_rate_hz)
    share = np.cumsum(energy.sum(axis=(0, 1)))
    band = (0.0, 0.5 * record.sample_rate_hz)
    if share[-1] > 0.0:
        ends = np.searchsorted(share, np.array([0.005, 0.995]) * share[-1])
        half = float(frequency[0])
        band = (float(frequency[ends[0]]) - half, float(frequency[ends[1]]) + half)
    total = energy.sum(axis=2)
    around = np.abs(np.arange(size) - energy.argmax(axis=2)[..., None]) <= SPREAD_BINS
    near = np.where(around, energy, 0.0).sum(axis=2)
    centre = np.where(around, energy * frequency, 0.0).sum(axis=2) / np.maximum(near, 1e-300)
    sinusoidal = (total > 1e-4 * max(float(total.max(initial=0.0)), 1e-300)) & (near > total - near)
    return np.asarray(np.where(sinusoidal, centre, np.nan)), band


def _harmonics(drives_hz: FloatArray, resonances_hz: Sequence[float], order: int) -> list[FloatArray]:
    """(K,) each [Hz]: sums of ``order`` drive frequencies (D, K); for orders above 1 also sums of ``order`` resonances."""
    rows = [np.sum(some, axis=0) for some in combinations_with_replacement(list(drives_hz), order)]
    if order == 1:
        return rows
    constant = np.ones(drives_hz.shape[1])
    return rows + [sum(some) * constant for some in combinations_with_replacement(list(resonances_hz), order)]


def _sum_bands(resonances_hz: Sequence[float]) -> list[Band]:
    """Bands of +-1 % [Hz] around the sums of two to MAX_ORDER resonances, where nonlinear modes respond together."""
    sums = [sum(some) for k in range(2, MAX_ORDER + 1) for some in combinations_with_replacement(resonances_hz, k)]
    return [(0.99 * f, 1.01 * f) for f in sums]
