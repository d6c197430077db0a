"""The scan for one more mode: its frequency and damping do not exist at its null, and a narrow mode wants a fine grid.

    H(s) = s / (s^2 + 2 zeta w s + w^2)            (w / (..) where the pick-off sees displacement)
    Z_{r,d} = sum_w gain[r, d, w] G H b_w,   T = s^T (Z~^T Z~)^-1 s / gamma         free for every drive and sense

in the bins around the mode, the baseline projected out: a fall of chi2 with S D degrees of freedom a point of the grid.
Complex bins are held as pairs of real numbers, the real part of z^* x is then a product of real matrices.
Shapes: R records, N samples, F bins, S senses, D drives, W waveforms, p columns of the baseline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.criticism.problem import FitResult, LocalCandidate
from pipeline.criticism.projection import Baseline, baseline
from pipeline.device.readout import plain_readout
from pipeline.experiment.antialias import filter_poles
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.linear import pole_states
from pipeline.experiment.play import Play

NAME = "parasitic_mode"
#: zeta, step of the grid as a share of the frequency, margins around the driven band (share of its edges).
_WIDE = (1e-2, 0.02, 1e9)
_NARROW = (1.5e-3, 0.003, 0.05)
_LOW_HZ = 300.0
#: Bins in which a waveform has this share of its strongest are driven.
_DRIVEN = 0.05
#: A mode is followed to where it has this share of its peak.
_SEEN = 2e-2
_CHUNK = 16


@dataclass(frozen=True, eq=False)
class Point:
    """A mode of the grid: its first bin, and its answer (W, bins) there to each waveform, scaled like the rows."""

    f_hz: float
    zeta: float
    first: int
    answer: ComplexArray


@dataclass(frozen=True, eq=False)
class Scan:
    """The grid of one play and the places of its records."""

    places: tuple[int, ...]
    gains: FloatArray
    points: tuple[Point, ...]

    @property
    def mixed(self) -> FloatArray:
        """(W, D R): how much of each waveform a drive plays in each record."""
        return np.asarray(self.gains.transpose(2, 1, 0).reshape(self.gains.shape[2], -1))


def grid_of(plays: Sequence[Play], top_hz: float) -> list[tuple[float, float]]:
    """(f, zeta) of the grid: wide modes up to ``top_hz``, narrow ones in the driven band."""
    low, high = np.inf, 0.0
    for play in plays:
        frequency = np.fft.rfftfreq(play.waveforms.shape[1], play.clock.step_s)
        for waveform in play.waveforms:
            power = np.abs(rfft(waveform))
            driven = frequency[power > _DRIVEN * power.max()]
            low, high = min(low, float(driven[0])), max(high, float(driven[-1]))
    found = []
    for zeta, step, margin in (_WIDE, _NARROW):
        first, last = max(_LOW_HZ, low / (1.0 + margin)), min(high * (1.0 + margin), top_hz)
        count = int(np.log(last / first) / step) + 1 if last > first else 0
        found += [(first * (1.0 + step) ** k, zeta) for k in range(count)]
    return found


def scan_of(
    places: tuple[int, ...],
    play: Play,
    instrument: Instrument,
    bins: int,
    grid: Sequence[tuple[float, float]],
    displacement: bool,
) -> Scan:
    """What the modes of ``grid`` answer in the first ``bins`` bins above zero of a play."""
    samples = play.drives[0].shape[0]
    omega = 2.0 * np.pi * np.arange(1, bins + 1) * play.sample_rate_hz / samples
    seen = np.ones(bins, dtype=np.complex128)
    if instrument.antialias is not None:
        seen = plain_readout(*filter_poles(instrument.antialias), 1, 1).response(1j * omega)[:, 0, 0]
    seen = seen * np.sqrt(2.0 / samples)
    points: list[Point] = []
    for start in range(0, len(grid), _CHUNK):
        part = grid[start : start + _CHUNK]
        w, zeta = 2.0 * np.pi * np.array([f for f, _ in part]), np.array([z for _, z in part])
        poles = w * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        residues = (w if displacement else poles) / (2j * poles.imag)
        answers = np.zeros((len(part), play.waveforms.shape[0], bins), dtype=np.complex128)
        for k, waveform in enumerate(play.waveforms):
            states = pole_states(poles, waveform, play.clock)[:: play.clock.stride].T
            y = 2.0 * (residues.real[:, None] * states[: w.size] - residues.imag[:, None] * states[w.size :])
            answers[:, k] = rfft(y, axis=-1)[:, 1 : bins + 1] * seen
        for (f, z), answer in zip(part, answers):
            size = np.max(np.abs(answer), axis=0, initial=0.0)
            strong = np.flatnonzero(size > _SEEN * size.max())
            first, last = (int(strong[0]), int(strong[-1]) + 1) if strong.size else (0, 1)
            points.append(Point(f, z, first, np.ascontiguousarray(answer[:, first:last])))
    return Scan(places, play.gains, tuple(points))


def mode_candidate(fit: FitResult, scans: Sequence[Scan], senses: int, sigma_v: FloatArray) -> LocalCandidate:
    """The fall of chi2 that one more mode brings at each point of the grid."""
    base = baseline(fit)
    ready = [_by_bin(base, scan.places, senses) for scan in scans]
    drives, p = scans[0].gains.shape[1], base.upper.shape[0]

    def at(k: int) -> tuple[float, float]:
        """Fall and noise level."""
        score, overlap = np.zeros((drives, senses)), np.zeros((drives, senses, p))
        gram, level, weight = np.zeros((drives, drives)), np.zeros(senses), 0.0
        for scan, (residual, basis, gamma) in zip(scans, ready):
            own = scan.points[k]
            part = slice(own.first, own.first + own.answer.shape[1])
            mixed = (own.answer.T @ scan.mixed).reshape(own.answer.shape[1], drives, -1)
            z = np.ascontiguousarray(np.moveaxis(mixed, 1, 0)).view(np.float64).reshape(drives, -1)
            energy = np.sum(z**2, axis=0)
            score += z @ residual[part].reshape(-1, senses)
            overlap += (z @ basis[part].reshape(z.shape[1], -1)).reshape(overlap.shape)
            gram += z @ z.T
            level += energy @ gamma[part].reshape(-1, senses)
            weight += float(energy.sum())
        return _fall(score, overlap, gram, sigma_v), max(float(np.max(level)) / max(weight, 1e-300), 1.0)

    points = scans[0].points
    found = [at(k) for k in range(len(points))]
    return LocalCandidate(
        NAME,
        tuple(fall for fall, _ in found),
        (drives * senses,) * len(points),
        tuple({f"{NAME}.f": point.f_hz, f"{NAME}.zeta": point.zeta} for point in points),
        levels=tuple(level for _, level in found),
    )


def _fall(score: FloatArray, overlap: FloatArray, gram: FloatArray, sigma_v: FloatArray) -> float:
    """s^T (Z~^T Z~)^-1 s over drives and senses, the columns of sense k in units of 1/sigma_k."""
    drives, senses = score.shape
    o = (overlap / sigma_v[:, None]).reshape(drives * senses, -1)
    full = np.einsum("de,st->dset", gram, np.diag(1.0 / sigma_v**2)).reshape(drives * senses, -1) - o @ o.T
    s = (score / sigma_v).reshape(-1)
    scale = np.sqrt(np.maximum(np.diagonal(full), 1e-300))
    size, vector = np.linalg.eigh(full / np.outer(scale, scale))
    along = vector.T @ (s / scale)
    good = size > 1e-6 * max(float(size[-1]), 1e-300)
    return float(np.sum(along[good] ** 2 / size[good]))


def _by_bin(base: Baseline, places: Sequence[int], senses: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residual (F, R, 2, S), basis (F, R, 2, S p) and noise level (F, R, 2, S) of some blocks, bin by bin."""

    def stacked(blocks: Sequence[FloatArray]) -> FloatArray:
        """(2 F S, ..) of each record -> (F, R, 2, S ..)."""
        rows = [blocks[i].reshape(2, blocks[i].shape[0] // (2 * senses), -1) for i in places]
        return np.ascontiguousarray(np.moveaxis(np.stack(rows), 2, 0))

    return stacked(base.residual), stacked(base.basis), stacked(base.gamma)
