"""Tests of structure in the residual, for misfits that no candidate explains.

chi2 alone is blind: over n rows its sd is sqrt(2 n), which is 850 for 360,000.  The tests are

    probe       correlation with generic shapes that the problem supplies                      chi2_k
    agreement   parameters that differ between blocks, or between the values of a label        chi2_rank
    region      energy of one region above the common level                                    chi2_d
    line        energy at one frequency above its neighbours, summed over the data             chi2_d
    repeat      correlation between residuals of repeats, over dyadic windows                  z = sum(a b) / sqrt(sum b^2)

Bonferroni's bound combines the tests, and the findings within each.  A common excess of the noise level is not structure: it is
divided out (``Projected``, ``gamma``; the median level of the regions).

``agreement`` tests whether the parts of the data agree on the size of a term:

    d_g   deviation in part g (a block, a level, a direction) from the common size, all other parameters common
    s_g = D' Q_g' r_g,   G_gh = D' (N_g delta_gh - N_g N_h) D,   N_g = Q_g' Q_g,   sum_g N_g = 1
    Q   = s' G^+ s  ~  chi2_rank          (Cochran's Q where nothing else is fitted)

D = R e_j are the columns of the term in the coordinates of Q.  A term that only imitates the missing one cannot do so with the
same size everywhere, so its parts disagree.  Shapes: n m rows of a block, p columns of the baseline.  Everything is in sigmas.
Source of Q: Cochran 1954.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from ..arrays import RANK, FloatArray
from .problem import FitResult, Region, Signatures, Spectrum
from .regions import description, normalized_energy
from .scores import Baseline, cells_of, delta_chi2s, project
from .significance import log_any, log_tail, normal_log_tail

#: Rows of the shortest window in which repeats are correlated, and of a chunk of held-out rows: longer than the correlation of
#: the noise.
WINDOW = 128
#: Median of |N(0, 1)|, and how many regions a family needs for its spread to be estimated: a single region would excuse itself.
_MEDIAN, _SPREAD_NEEDS = float(ndtri(0.75)), 8


@dataclass(frozen=True)
class ResidualStructure:
    """The strongest finding of one test, its log p (the number of places tested counted), and its place."""

    test: str
    log_p: float
    where: str


@dataclass(frozen=True)
class ResidualTests:
    """All tests together; ``p_value`` by Bonferroni, ``level`` the rms [sigma] of the residual per degree of freedom.

    ``explained``: the part of chi2 that one family of probes explains, less its rank; the misfit is at least as large.
    """

    p_value: float
    structures: tuple[ResidualStructure, ...]
    level: float
    explained: float = 0.0

    @property
    def worst(self) -> ResidualStructure | None:
        """The most significant structure."""
        return min(self.structures, key=lambda structure: structure.log_p, default=None)


def goodness(
    fit: FitResult, base: Baseline, probes: Signatures, regions: Sequence[Region], spectra: Sequence[Spectrum] = ()
) -> ResidualTests:
    """Test the residual of a fit with known noise level for structure; p is 1 where the level is unknown.

    Parameters
    ----------
    fit, base : the fit and its baseline (all columns of the jacobian).
    probes, regions, spectra : supplied by the problem; may be empty.
    """
    chi2 = sum(float(np.vdot(r, r)) for r in base.residual)
    level = float(np.sqrt(chi2 / max(base.dof, 1)))
    if not fit.noise_known:
        return ResidualTests(1.0, (), level)
    probed, explained = _probes(base, probes)
    results = [
        probed,
        _agreements(fit, base),
        _regions(regions),
        _lines(spectra),
        _repeats(fit, base),
    ]
    structures = tuple(structure for structure in results if structure is not None)
    if not structures:
        return ResidualTests(1.0, (), level)
    smallest = min(structure.log_p for structure in structures)
    return ResidualTests(float(np.exp(log_any(smallest, len(structures)))), structures, level, explained)


def excess(regions: Sequence[Region]) -> float:
    """Residual energy above the common level of the regions, less three sd; zero without regions.

    Each family of regions partitions the same residual.  The median over the families is returned.
    """
    energies = []
    for family in {region.family for region in regions}:
        own = [region for region in regions if region.family == family and region.dof > 0.0]
        energy, dof = np.array([region.chi2 for region in own]), np.array([region.dof for region in own])
        if not own:
            continue
        level = max(1.0, float(np.median(energy / dof)))
        # The median of n energies is 1.25 times as uncertain as their mean.
        error = 1.6 * level * float(np.sqrt(2.0 * dof.sum()))
        energies.append(max(float(energy.sum() - level * dof.sum()) - 3.0 * error, 0.0))
    return float(np.median(energies)) if energies else 0.0


def _strongest(test: str, log_p: Sequence[float], where: Sequence[str]) -> ResidualStructure | None:
    if not log_p:
        return None
    worst = int(np.argmin(log_p))
    return ResidualStructure(test, float(log_any(log_p[worst], len(log_p))), where[worst])


def _probes(base: Baseline, probes: Signatures) -> tuple[ResidualStructure | None, float]:
    """The strongest family of probes, and the largest part of chi2 that one explains (its rank subtracted)."""
    if not probes.candidates:
        return None, 0.0
    projected, explained = project(base, probes.blocks), 0.0
    log_p, where = [], []
    for candidate in probes.candidates:
        for cell in cells_of(projected, candidate):
            if cell.rank == 0:
                continue
            delta_chi2 = float(delta_chi2s(cell, projected.score[:, None])[0][0])
            log_p.append(float(log_tail(delta_chi2 / cell.inflation, cell.rank)))
            where.append(candidate.name)
            explained = max(explained, delta_chi2 - cell.rank)
    return _strongest("probe", log_p, where), explained


def _agreements(fit: FitResult, base: Baseline) -> ResidualStructure | None:
    log_p, where = [], []
    for name, parts in partitions(fit).items():
        overall = agreement(base, name, parts)
        log_p.append(overall.log_p)
        where.append(f"all parameters by {name}")
        for term, columns in fit.columns.items():
            if not columns:
                continue
            log_p.append(agreement(base, name, parts, columns).log_p)
            where.append(f"{term} by {name}")
    return _strongest("agreement", log_p, where)


def _regions(regions: Sequence[Region]) -> ResidualStructure | None:
    """Energies relative to the median level of their family; its spread replaces 2 dof as the variance where it is larger.

    The noise level of a region has an sd of its own (``noise_sd``): without it, 2 of 17 campaigns of coloured noise without a
    hidden effect were "unknown".
    """
    log_p, where = [], []
    for family in sorted({region.family for region in regions}):
        own = [region for region in regions if region.family == family and region.dof > 0.0]
        energy = np.array([region.chi2 if region.robust is None else region.robust for region in own])
        dof = np.array([region.dof for region in own])
        level = max(1.0, float(np.median(energy / dof))) if own else 1.0
        z = (energy / level - dof) / np.sqrt(2.0 * dof)
        spread = max(1.0, float(np.median(np.abs(z))) / _MEDIAN) if len(own) >= _SPREAD_NEEDS else 1.0
        for region, value, count in zip(own, energy / level, dof):
            # A multiple of chi2 with the right mean and variance, 2 dof spread^2 + (dof noise_sd)^2.
            wider = spread**2 + 0.5 * count * region.noise_sd**2
            log_p.append(float(log_tail(value / wider, max(round(count / wider), 1))))
            where.append(description(region))
    return _strongest("region", log_p, where)


def _lines(spectra: Sequence[Spectrum]) -> ResidualStructure | None:
    log_p, where = [], []
    for spectrum in spectra:
        energy = normalized_energy(spectrum)
        top = int(np.argmax(energy))
        log_p.append(float(log_any(log_tail(energy[top], spectrum.dof), energy.size)))
        where.append(f"line at {spectrum.frequency_hz[top]:.5g} Hz")
    return _strongest("line", log_p, where)


def _repeats(fit: FitResult, base: Baseline) -> ResidualStructure | None:
    log_p: list[float] = []
    where: list[str] = []
    marks = [block.repeat for block in fit.blocks]
    for i, mark in enumerate(marks):
        if mark is None or mark not in marks[i + 1 :]:
            continue
        j = marks.index(mark, i + 1)
        z, windows = _correlated(base.residual[i], base.residual[j], base.gamma[i])
        log_p.extend((normal_log_tail(np.maximum(z, 0.0))).tolist())
        where.extend(f"{fit.blocks[i].name} and {fit.blocks[j].name}, rows {a} to {b}" for a, b in windows)
    return _strongest("repeat", log_p, where)


def _correlated(a: FloatArray, b: FloatArray, gamma: FloatArray) -> tuple[FloatArray, list[tuple[int, int]]]:
    """z of every dyadic window of rows: given b, sum(a b) is normal with variance sum(gamma b^2)."""
    product = np.concatenate([[0.0], np.cumsum(a * b)])
    energy = np.concatenate([[0.0], np.cumsum(gamma * b * b)])
    windows: list[tuple[int, int]] = []
    size = a.size
    while size >= WINDOW:
        # The last window of each size takes the remaining rows.
        edges = [*range(0, a.size - size + 1, size)]
        windows.extend(zip(edges, [*edges[1:], a.size]))
        size //= 2
    first, stop = np.array(windows, dtype=np.int64).reshape(-1, 2).T
    z = (product[stop] - product[first]) / np.sqrt(np.maximum(energy[stop] - energy[first], 1e-300))
    return np.asarray(z), windows


@dataclass(frozen=True)
class Agreement:
    """Whether the parts of one partition agree on some parameters.

    Parameters
    ----------
    partition : "block", or the label whose values define the parts.
    statistic, dof : Q and its degrees of freedom.
    log_p : log P(Q* > Q) where they agree.
    sizes : part -> (deviation from the common size, sd), in the unit of the parameter; for a single parameter only.
    """

    partition: str
    statistic: float
    dof: int
    log_p: float
    sizes: Mapping[str, tuple[float, float]]


def partitions(fit: FitResult) -> dict[str, dict[str, list[int]]]:
    """Partition -> part -> indices of blocks: by block, and by every label with at least two values."""
    parts_by = {"block": {f"{i}:{block.name}": [i] for i, block in enumerate(fit.blocks)}}
    for label in sorted({label for block in fit.blocks for label in block.labels}):
        parts: dict[str, list[int]] = {}
        for i, block in enumerate(fit.blocks):
            parts.setdefault(block.labels.get(label, ""), []).append(i)
        parts_by[label] = parts
    return {name: parts for name, parts in parts_by.items() if len(parts) > 1}


def agreement(
    base: Baseline, partition: str, parts: Mapping[str, Sequence[int]], columns: Sequence[int] | None = None
) -> Agreement:
    """Q over ``parts`` (part -> indices of blocks) for these columns of the jacobian, or for all of them together."""
    p = base.upper.shape[0]
    directions = np.eye(p) if columns is None else base.upper[:, list(columns)]
    directions = directions / np.maximum(np.linalg.norm(directions, axis=0), 1e-300)
    count, k = len(parts), directions.shape[1]
    inside, spread, score = np.zeros((count, p, p)), np.zeros((count, p, p)), np.zeros((count, p))
    for g, blocks in enumerate(parts.values()):
        for b in blocks:
            q, r = base.basis[b], base.residual[b]
            inside[g] += q.T @ q
            spread[g] += q.T @ (q * base.gamma[b][:, None])
            score[g] += q.T @ r
    # s_g - N_g sum(s): the part's score with the common parameters projected out, as a matrix that acts on the stacked s.
    rejection = np.zeros((count, p, count, p))
    for g in range(count):
        rejection[g, :, :, :] = -inside[g][:, None, :]
        rejection[g, :, g, :] += np.eye(p)
    rejection_d = np.einsum("pk,gphq->gkhq", directions, rejection).reshape(count * k, count * p)
    s = rejection_d @ score.reshape(-1)
    gram = _sandwich(rejection_d, inside)
    covariance = _sandwich(rejection_d, spread)
    size, vector = np.linalg.eigh(gram)
    good = size > RANK * max(float(size[-1]), 1e-300)
    rank = int(good.sum())
    inverse = (vector[:, good] / size[good]) @ vector[:, good].T
    inflation = max(1.0, float(np.trace(inverse @ covariance)) / max(rank, 1))
    statistic = float(s @ inverse @ s) / inflation
    sizes = {}
    if k == 1 and columns is not None:
        norm = float(np.linalg.norm(base.upper[:, list(columns)]))
        weight = np.array([float(directions[:, 0] @ n @ directions[:, 0]) for n in inside])
        shift = inverse @ s
        shift = shift - float(weight @ shift) / max(float(weight.sum()), 1e-300)
        sd = np.sqrt(inflation / np.maximum(weight, 1e-300)) / norm
        sizes = {part: (float(d) / norm, float(e)) for part, d, e in zip(parts, shift, sd)}
    return Agreement(partition, statistic, rank, float(log_tail(statistic, rank)) if rank else 0.0, sizes)


def _sandwich(rejection: FloatArray, blocks: FloatArray) -> FloatArray:
    """P blockdiag(B_g) P'."""
    count, p, _ = blocks.shape
    wide = rejection.reshape(-1, count, p)
    return np.asarray(np.einsum("agp,gpq,bgq->ab", wide, blocks, wide, optimize=True))
