"""What ``criticism`` needs from a problem: fits with whitened residuals, candidate terms, and held-out data.

    r = (measured - model) / sigma         whitened residual of the fit (dimensionless)
    J = d model / d parameter / sigma      at the fit; a step dp changes the residual by -J dp
    Z = d model / d candidate / sigma      at the null of the candidate, per unit of its parameters

Rows come in named blocks, for example one per record or one per wafer.  Block b has a residual (n_b, m_b), whose elements in C
order are the rows of J_b (n_b m_b, P) and Z_b (n_b m_b, K).  Rows may be any unitary transform of the data, such as time
samples or Fourier coefficients.  Free amplitudes of a single block (offsets, lines) are either columns of J or already
projected out of r, J and Z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """Whitened residual of one record, wafer or other unit of data.

    Parameters
    ----------
    name : of the record or wafer.
    residual : (n, m) [sigma], of unit variance where model and noise level are right.
    labels : conditions, such as {"level": "0.35", "direction": "up"}; the size of a term is compared between them.
    repeat : blocks with the same mark are repeats, equal row by row except for the noise.
    nuisances : number of free amplitudes fitted to this block; corrects the comparison of held-out chi2.
    """

    name: str
    residual: FloatArray
    labels: Mapping[str, str] = field(default_factory=dict)
    repeat: str | None = None
    nuisances: int = 0

    @property
    def rows(self) -> FloatArray:
        """(n m,) residual [sigma] in the row order of J and Z."""
        return self.residual.reshape(-1)

    @property
    def chi2(self) -> float:
        """Sum over n m rows of r^2."""
        return float(np.vdot(self.residual, self.residual))


@dataclass(frozen=True, eq=False)
class FitResult:
    """One fit of the model with some terms.

    Parameters
    ----------
    ok : the fit converged and may be judged; ``why`` gives the reason otherwise.
    terms : terms in the model besides the baseline.
    parameters, derived : name -> (value, sd).
    blocks, held : fitted and held-out blocks; only the free amplitudes of held-out blocks were fitted to them.
    jacobian : for each fitted block J (n m, P) [sigma per unit of the parameter].
    columns : term -> its columns in the jacobian.
    shifts : term -> value - null of the parameter of each of its columns, in the unit of the column (zero for a parameter
        that does not exist at the null).
    strata : for each fitted block (n m,) the noise stratum of a row, from 0.  A stratum is a few hundred or more rows with a
        common noise level, which the residuals check.  ``None``: unit variance is assumed everywhere.
    noise_known : false where the residuals are white up to an unknown common factor.
    noise_bounded : with an unknown level: the variance is at most 1, so chi2/dof well above 1 is a misfit.
    nuisances : number of amplitudes that were projected out; they reduce the degrees of freedom.
    at_limit : terms with a parameter at a limit of its range other than its null, or at a value where the term duplicates
        part of the model.
    error_given : false where the noise level is no independent measure, so that errors in units of it are not given.
    misfit : why the problem itself calls this fit a misfit, whatever its noise level; empty where it does not.
    error, relative_error : "fit" and "validate" as the problem defines them; an omitted error
        is the rms of the residuals [sigma].
    """

    ok: bool
    terms: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float]]
    blocks: tuple[ResidualBlock, ...]
    jacobian: tuple[FloatArray, ...]
    why: str = ""
    derived: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    held: tuple[ResidualBlock, ...] = ()
    columns: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    shifts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    strata: tuple[IntArray, ...] | None = None
    noise_known: bool = True
    nuisances: int = 0
    error: Mapping[str, float] = field(default_factory=dict)
    relative_error: Mapping[str, float] = field(default_factory=dict)
    noise_bounded: bool = False
    at_limit: tuple[str, ...] = ()
    misfit: str = ""
    error_given: bool = True

    @property
    def chi2(self) -> float:
        """Sum of r^2 over the rows of the fitted blocks."""
        return sum(block.chi2 for block in self.blocks)

    @property
    def rows(self) -> int:
        """Number of rows of all fitted blocks."""
        return sum(block.residual.size for block in self.blocks)

    @property
    def dof(self) -> int:
        """Rows less the P free parameters and the nuisances."""
        return self.rows - (self.jacobian[0].shape[1] if self.jacobian else 0) - self.nuisances

    def error_of(self, part: str) -> float | None:
        """sqrt(chi2 / rows) [sigma] on "fit" or "validate", or the error that the problem gives.

        ``None`` without data of that kind, with an unknown noise level, or where errors are not given.
        """
        if not self.error_given:
            return None
        if part in self.error:
            return self.error[part]
        blocks = self.blocks if part == "fit" else self.held
        if not blocks or not self.noise_known:
            return None
        return float(np.sqrt(sum(block.chi2 for block in blocks) / sum(block.residual.size for block in blocks)))


@dataclass(frozen=True)
class TermParameter:
    """A parameter of a candidate term.

    Parameters
    ----------
    name, unit : of the parameter.
    null : value at which the term has no effect.
    reach : largest |value - null| of its declared range for which its column holds.
    side : +1 or -1 where the null is a boundary and only values above or below exist, else 0.
    """

    name: str
    unit: str = "1"
    null: float = 0.0
    reach: float = np.inf
    side: int = 0

    @classmethod
    def with_range(cls, name: str, unit: str, null: float, low: float, high: float) -> TermParameter:
        """A parameter with the declared range [low, high], in ``unit``; a null at an end of the range sets ``side``."""
        side = 1 if low == null else (-1 if high == null else 0)
        return cls(name, unit, null, max(abs(high - null), abs(low - null)), side)


@dataclass(frozen=True)
class Candidate:
    """An absent term.

    Parameters
    ----------
    name : of the term.
    parameters : k parameters, in the order of its columns.
    cells : for each grid point its k columns of Z; a single cell where nothing is scanned.
    grid : for each cell the values of the parameters that do not exist at the null.
    """

    name: str
    parameters: tuple[TermParameter, ...]
    cells: tuple[slice, ...]
    grid: tuple[Mapping[str, float], ...] = ({},)


@dataclass(frozen=True)
class LocalCandidate:
    """An absent term with free amplitudes in every block, such as mains lines.

    Parameters
    ----------
    name : of the term.
    delta_chi2s, dofs : decrease of chi2 at each grid point; at the null, delta_chi2 / level is chi-square of ``dofs``.
    grid : for each grid point the values of the scanned parameters.
    reach : expected delta_chi2 (the square of its SNR) of the strongest term within the declared range.
    levels : noise variance at each grid point; 1 where omitted.
    """

    name: str
    delta_chi2s: tuple[float, ...]
    dofs: tuple[int, ...]
    grid: tuple[Mapping[str, float], ...] = ({},)
    reach: float = np.inf
    levels: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Signatures:
    """Candidates and their columns.

    Parameters
    ----------
    candidates : absent terms, each with its cells of columns; a column may belong to none.
    blocks : for each fitted block Z_b (n m, K) [sigma per unit of the parameter].
    local : candidates with free amplitudes in every block.
    grams : ``stratum_grams`` of the blocks (strata, K, K), where the problem stores them.
    curved : names of candidates of which the baseline may absorb the column but not the second order; a refit from a size that
        is not null shows them.
    beside : those of ``curved`` beside which the records were corrected; they are refitted even where no structure is left.
    """

    candidates: tuple[Candidate, ...]
    blocks: tuple[FloatArray, ...]
    local: tuple[LocalCandidate, ...] = ()
    grams: FloatArray | None = None
    curved: frozenset[str] = frozenset()
    beside: frozenset[str] = frozenset()


def stratum_grams(columns: Sequence[FloatArray], strata: Sequence[IntArray]) -> FloatArray:
    """Z' Z of the rows of each stratum (strata, K, K), which is the same for every fit.

    Parameters
    ----------
    columns : for each block Z_b (n m, K).
    strata : for each block (n m,) the stratum of a row, from 0.
    """
    count = 1 + max(int(part.max(initial=0)) for part in strata)
    grams = np.zeros((count, columns[0].shape[1], columns[0].shape[1]))
    for z, own in zip(columns, strata):
        for stratum in np.unique(own):
            part = z.T[:, own == stratum]
            grams[stratum] += part @ part.T
    return grams


@dataclass(frozen=True)
class Region:
    """Residual energy and degrees of freedom in one part of the data.

    Parameters
    ----------
    family : regions of one family partition the data along one quantity (frequency, time, level); their shares add up to 1.
    labels : where the region lies.
    chi2, dof : energy (sum of squared whitened residuals) and degrees of freedom.
    robust : the same energy with single outliers clipped, for tests that must not respond to heavy-tailed noise.
    noise_sd : relative sd of the noise level there, beyond that of the whole data.
    """

    family: str
    labels: Mapping[str, object]
    chi2: float
    dof: float
    robust: float | None = None
    noise_sd: float = 0.0


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Residual energy by frequency, summed over all data with the same frequency grid; used to find single lines.

    Parameters
    ----------
    frequency_hz, chi2 : (M,) [Hz] and energy; neighbours may share energy.
    dof : degrees of freedom of each.
    """

    frequency_hz: FloatArray
    chi2: FloatArray
    dof: int


class Problem(Protocol):
    """A model and its data.  Whoever implements it (a campaign, a modal record, a lot) can be diagnosed and refined."""

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Fit the baseline with these terms, from several starts; ``ok`` is false where that failed."""
        ...

    def signatures(self, fit: FitResult) -> Signatures:
        """Candidates that the model of the fit lacks, with their columns Z (n m, K) at the null."""
        ...

    def probes(self, fit: FitResult) -> Signatures:
        """Generic shapes (n m, K) that any misfit is likely to correlate with; they are never named.  May be empty."""
        ...

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """Residual energy by region.  May be empty."""
        ...

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Residual energy of whole blocks by frequency, one spectrum per frequency grid.  May be empty."""
        ...
