"""The scan for an additional mode over a grid of frequency and damping ratio, which do not exist at its null.

    H(s) = w^(1 - m) s^m / (s^2 + 2 zeta w s + w^2)         pick-offs of displacement, velocity, acceleration: m = 0, 1, 2
    Z_{r,d} = sum_w gain[r, d, w] G H b_w,   delta_chi2 = s^T (Z~^T Z~)^-1 s,   s = Z~^T r~        free for every drive and sense

G is the anti-alias filter and b_w the spectrum of waveform w; the baseline is projected out of Z and r.  A record that does not
start at rest has two more columns, the decay of the mode from any state.  A grid point has S (D + 2 R') degrees of freedom, R'
such records.  Only the bins around the mode are used, so that a narrow mode can have a fine grid.
Complex bins are held as pairs of real numbers, so that the real part of z^* x is a product of real matrices.

Shapes: R records, N samples, F bins, S senses, D drives, W waveforms, P poles, K grid points, Q = D + 2 R',
p columns of the baseline.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...criticism.problem import FitResult, LocalCandidate
from ...criticism.scores import Baseline, baseline
from .mode_grid import TOGETHER, Scan, ScanPoint


def mode_candidate(
    name: str, mode: tuple[str, str], fit: FitResult, scans: Sequence[Scan], senses: int, sigma_v: FloatArray
) -> LocalCandidate:
    """The decrease of chi2 by an additional mode at each grid point; ``sigma_v`` (S,) is the noise level [V]."""
    base = baseline(fit)
    stacked = [_by_bin(base, scan.places, senses) for scan in scans]
    drives, p = scans[0].gains.shape[1], base.upper.shape[0]
    first_decay = np.cumsum([drives, *(2 * len(scan.moving) for scan in scans)])
    columns = int(first_decay[-1])
    points = scans[0].points

    def scored(first: int) -> tuple[FloatArray, FloatArray]:
        """Decrease of chi2 and noise level (K,) of the grid points scored together."""
        together = slice(first, first + TOGETHER)
        size = len(points[together])
        score, overlap = np.zeros((size, columns, senses)), np.zeros((size, columns, senses, p))
        gram, level, weight = np.zeros((size, columns, columns)), np.zeros((size, senses)), np.zeros((size, 1))
        for scan, decays, (residual, basis, gamma) in zip(scans, first_decay, stacked):
            begin, response, decay = _side_by_side(scan.points[together])
            part = slice(begin, begin + response.shape[1])
            mixed = (response @ scan.mixing).reshape(size, response.shape[1], drives, len(scan.places))
            if columns > drives:
                free = np.zeros((*mixed.shape[:2], columns, mixed.shape[3]), dtype=np.complex128)
                free[:, :, :drives] = mixed
                for k, record in enumerate(scan.moving):
                    free[:, :, decays + 2 * k : decays + 2 * k + 2, record] = decay
                mixed = free
            z = np.ascontiguousarray(np.moveaxis(mixed, 2, 1)).view(np.float64).reshape(size, columns, -1)
            flat, energy = z.reshape(size * columns, -1), np.sum(z[:, :drives] ** 2, axis=1)
            score += (flat @ residual[part].reshape(-1, senses)).reshape(score.shape)
            overlap += (flat @ basis[part].reshape(flat.shape[1], -1)).reshape(overlap.shape)
            gram += z @ np.swapaxes(z, 1, 2)
            level += energy @ gamma[part].reshape(-1, senses)
            weight += energy.sum(axis=1, keepdims=True)
        levels = np.max(level / np.maximum(weight, 1e-300), axis=1)
        return _delta_chi2(score, overlap, gram, sigma_v), np.maximum(levels, 1.0)

    found = [scored(first) for first in range(0, len(points), TOGETHER)]
    delta_chi2s, levels = (np.concatenate(part).tolist() for part in zip(*found))
    return LocalCandidate(
        name,
        tuple(delta_chi2s),
        (columns * senses,) * len(points),
        tuple({mode[0]: point.f_hz, mode[1]: point.zeta} for point in points),
        levels=tuple(levels),
    )


def _side_by_side(points: Sequence[ScanPoint]) -> tuple[int, ComplexArray, ComplexArray]:
    """First bin, responses (K, F, W) and decays (K, F, 2) of neighbouring grid points, in the bins of any of them."""
    first = min(point.first for point in points)
    last = max(point.first + point.response.shape[1] for point in points)
    shape = (len(points), last - first)
    out = np.zeros((*shape, points[0].response.shape[0]), dtype=np.complex128)
    decays = np.zeros((*shape, points[0].decay.shape[0]), dtype=np.complex128)
    for own, decay, point in zip(out, decays, points):
        part = slice(point.first - first, point.first - first + point.response.shape[1])
        own[part], decay[part] = point.response.T, point.decay.T
    return first, out, decays


def _delta_chi2(score: FloatArray, overlap: FloatArray, gram: FloatArray, sigma_v: FloatArray) -> FloatArray:
    """s^T (Z~^T Z~)^-1 s over columns and senses (K,); the columns of sense k are in units of 1/sigma_k.

    score (K, Q, S), overlap (K, Q, S, p) with the baseline, gram (K, Q, Q) before the projection.
    """
    count, columns, senses = score.shape
    width = columns * senses
    o = (overlap / sigma_v[:, None]).reshape(count, width, -1)
    full = np.einsum("kde,st->kdset", gram, np.diag(1.0 / sigma_v**2)).reshape(count, width, width)
    full = full - o @ np.swapaxes(o, 1, 2)
    s = (score / sigma_v).reshape(count, width)
    scale = np.sqrt(np.maximum(np.diagonal(full, axis1=1, axis2=2), 1e-300))
    size, vector = np.linalg.eigh(full / (scale[:, :, None] * scale[:, None, :]))
    along = np.einsum("kij,ki->kj", vector, s / scale)
    good = size > 1e-6 * np.maximum(size[:, -1:], 1e-300)
    return np.asarray(np.sum(np.where(good, along**2 / np.where(good, size, 1.0), 0.0), axis=1))


def _by_bin(base: Baseline, places: Sequence[int], senses: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residual (F, R, 2, S), basis (F, R, 2, S p) and noise level (F, R, 2, S) of some blocks, bin by bin."""

    def by_bin(blocks: Sequence[FloatArray]) -> FloatArray:
        """(2 F S, ..) of each record -> (F, R, 2, S ..)."""
        rows = [blocks[i].reshape(2, blocks[i].shape[0] // (2 * senses), -1) for i in places]
        return np.ascontiguousarray(np.moveaxis(np.stack(rows), 2, 0))

    return by_bin(base.residual), by_bin(base.basis), by_bin(base.gamma)
