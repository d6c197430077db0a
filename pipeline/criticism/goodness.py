"""What is left: tests of structure in the residual, for misfits that no candidate names.

chi2 alone is blind: over n rows its sd is sqrt(2 n), 850 for 360,000.  Structure is looked for

    probe       along generic shapes that the problem supplies                        chi2_k
    agreement   as parameters on which the blocks, or the blocks of a label, differ    Cochran's Q
    region      as residual energy in one region beyond the common level              chi2_d
    line        as energy at one frequency beyond its neighbourhood, summed over the data   chi2_d
    repeat      as correlation between residuals of repeats, over dyadic windows       z = sum(a b) / sqrt(sum b^2)

and judged together, each family and the families among each other by Bonferroni's bound.  A common excess of the noise level
is no structure: it is divided out (``Projected``, ``gamma``; the median level of the regions).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .agreement import agreement, partitions
from .lines import normalized_energy
from .problem import FitResult, Region, Signatures, Spectrum
from .projection import Baseline, project
from .regions import description
from .scores import cells_of, delta_chi2s
from .tails import log_any, log_tail, normal_log_tail

_WINDOW = 128
#: Median of |N(0, 1)|, and the regions a family needs before its spread says something.
_MEDIAN = 0.6745
_FEW = 8


@dataclass(frozen=True)
class ResidualStructure:
    """The strongest finding of one test: its log p within the test, and where it was found."""

    test: str
    log_p: float
    where: str


@dataclass(frozen=True)
class ResidualTests:
    """All tests together: p is Bonferroni's over them; ``level`` is rms of the residual per degree of freedom."""

    p_value: float
    structures: tuple[ResidualStructure, ...]
    level: float

    @property
    def worst(self) -> ResidualStructure | None:
        """The most significant structure."""
        return min(self.structures, key=lambda structure: structure.log_p, default=None)


def goodness(
    fit: FitResult, base: Baseline, probes: Signatures, regions: Sequence[Region], spectra: Sequence[Spectrum] = ()
) -> ResidualTests:
    """Look for structure in the residual of a fit with known noise level.

    Parameters
    ----------
    fit, base : the fit and its orthonormal baseline (all columns in).
    probes, regions, spectra : what the problem supplies; may be empty.
    """
    chi2 = sum(float(np.vdot(r, r)) for r in base.residual)
    level = float(np.sqrt(chi2 / max(base.dof, 1)))
    if not fit.noise_known:
        return ResidualTests(1.0, (), level)
    found = [
        _probes(base, probes),
        _agreements(fit, base),
        _regions(regions),
        _lines(spectra),
        _repeats(fit, base),
    ]
    structures = tuple(structure for structure in found if structure is not None)
    if not structures:
        return ResidualTests(1.0, (), level)
    smallest = min(structure.log_p for structure in structures)
    return ResidualTests(float(np.exp(log_any(smallest, len(structures)))), structures, level)


def excess(regions: Sequence[Region]) -> float:
    """Residual energy that stands above the common level of the regions, three sd of its own error taken off.

    Every family of regions cuts the same residual; the median of what they say counts.  Zero without regions.
    """
    found = []
    for family in {region.family for region in regions}:
        own = [region for region in regions if region.family == family and region.dof > 0.0]
        energy, dof = np.array([region.chi2 for region in own]), np.array([region.dof for region in own])
        if not own:
            continue
        level = max(1.0, float(np.median(energy / dof)))
        # The median of n energies is 1.25 times as uncertain as their mean.
        error = 1.6 * level * float(np.sqrt(2.0 * dof.sum()))
        found.append(max(float(energy.sum() - level * dof.sum()) - 3.0 * error, 0.0))
    return float(np.median(found)) if found else 0.0


def _strongest(test: str, log_p: Sequence[float], where: Sequence[str]) -> ResidualStructure | None:
    if not log_p:
        return None
    worst = int(np.argmin(log_p))
    return ResidualStructure(test, float(log_any(log_p[worst], len(log_p))), where[worst])


def _probes(base: Baseline, probes: Signatures) -> ResidualStructure | None:
    if not probes.candidates:
        return None
    projected = project(base, probes.blocks)
    log_p, where = [], []
    for candidate in probes.candidates:
        for cell in cells_of(projected, candidate):
            if cell.rank == 0:
                continue
            fall = float(delta_chi2s(cell, projected.score[:, None])[0][0])
            log_p.append(float(log_tail(fall / cell.inflation, cell.rank)))
            where.append(candidate.name)
    return _strongest("probe", log_p, where)


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
    """Energies against their family's median level, their variance taken from the family where it exceeds 2 dof."""
    log_p, where = [], []
    for family in sorted({region.family for region in regions}):
        own = [region for region in regions if region.family == family and region.dof > 0.0]
        energy = np.array([region.chi2 if region.robust is None else region.robust for region in own])
        dof = np.array([region.dof for region in own])
        level = max(1.0, float(np.median(energy / dof))) if own else 1.0
        z = (energy / level - dof) / np.sqrt(2.0 * dof)
        spread = max(1.0, float(np.median(np.abs(z))) / _MEDIAN) if len(own) >= _FEW else 1.0
        for region, value, count in zip(own, energy / level, dof):
            # Scaled so that mean and variance are right: chi2 of dof / spread^2, times spread^2.
            log_p.append(float(log_tail(value / spread**2, max(round(count / spread**2), 1))))
            where.append(description(region))
    return _strongest("region", log_p, where)


def _lines(spectra: Sequence[Spectrum]) -> ResidualStructure | None:
    log_p, where = [], []
    for spectrum in spectra:
        beyond = normalized_energy(spectrum)
        top = int(np.argmax(beyond))
        log_p.append(float(log_any(log_tail(beyond[top], spectrum.dof), beyond.size)))
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
        z, place = _correlated(base.residual[i], base.residual[j], base.gamma[i])
        log_p.extend((normal_log_tail(np.maximum(z, 0.0))).tolist())
        where.extend(f"{fit.blocks[i].name} and {fit.blocks[j].name}, rows {a} to {b}" for a, b in place)
    return _strongest("repeat", log_p, where)


def _correlated(a: FloatArray, b: FloatArray, gamma: FloatArray) -> tuple[FloatArray, list[tuple[int, int]]]:
    """z of every dyadic window of rows: given b, sum(a b) is normal with variance sum(gamma b^2)."""
    product = np.concatenate([[0.0], np.cumsum(a * b)])
    energy = np.concatenate([[0.0], np.cumsum(gamma * b * b)])
    place: list[tuple[int, int]] = []
    size = a.size
    while size >= _WINDOW:
        # The last window of a row of them takes the remainder.
        edges = [*range(0, a.size - size + 1, size)]
        place.extend(zip(edges, [*edges[1:], a.size]))
        size //= 2
    first, stop = np.array(place, dtype=np.int64).reshape(-1, 2).T
    z = (product[stop] - product[first]) / np.sqrt(np.maximum(energy[stop] - energy[first], 1e-300))
    return np.asarray(z), place
