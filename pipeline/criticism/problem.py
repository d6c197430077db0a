"""What criticism sees: a model with parameters, whitened residuals, candidate terms with null values, held-out data.

    r = (measured - model) / sigma         whitened residual of the fit
    J = d model / d parameter / sigma      at the fit, so that a step dp changes the residual by -J dp
    Z = d model / d candidate / sigma      at the candidate's null, in its own units

Rows come in named blocks (a record, a wafer): block b has a residual (n_b, m_b), whose rows in C order are the rows of J_b
(n_b m_b, P) and Z_b (n_b m_b, K).  Any unitary picture of the data will do (time samples, or their Fourier coefficients).
Free amplitudes of single blocks (offsets, lines) are either columns of J or already projected out of r, J and Z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """Whitened residuals that belong together.

    Parameters
    ----------
    name : of the record, the wafer.
    residual : (n, m), unit variance where model and noise are right.
    labels : conditions, such as {"level": "0.35", "direction": "up"}; sizes of a term are compared across them.
    repeat : blocks with the same mark are repeats: row by row the same but for the noise.
    nuisances : free amplitudes of this block, to compare held-out blocks fairly.
    """

    name: str
    residual: FloatArray
    labels: Mapping[str, str] = field(default_factory=dict)
    repeat: str | None = None
    nuisances: int = 0

    @property
    def rows(self) -> FloatArray:
        """(n m,) the residual in the order of the rows of J and Z."""
        return self.residual.reshape(-1)

    @property
    def chi2(self) -> float:
        """Sum of squares."""
        return float(np.vdot(self.residual, self.residual))


@dataclass(frozen=True, eq=False)
class FitResult:
    """One fit of the model with some terms.

    Parameters
    ----------
    ok : the fit converged to something that may be judged; ``why`` says what went wrong otherwise.
    terms : those in the model beside the baseline.
    parameters, derived : name -> (value, sd).
    blocks, held : fitted and held-out blocks; of held-out blocks only their own free amplitudes were refitted.
    jacobian : for each fitted block (n m, P).
    columns : term -> its columns in the jacobian.
    shifts : term -> for each of its columns how far the parameter is from its null, in the column's units (zero for a
        parameter that does not exist at the null).
    strata : for each fitted block (n m,) the noise stratum of a row, from 0: rows (a few hundred or more) whose noise has
        one level, which is then checked on the residuals.  ``None``: unit variance is trusted everywhere.
    noise_known : false where the residuals are white up to an unknown common factor.
    noise_bounded : where it is unknown: the noise has at most unit variance, so chi2/dof well above 1 is a misfit.
    nuisances : free amplitudes that were projected out, counted in the degrees of freedom.
    at_limit : terms of which a parameter ran to an end of its range that is not its null, or to where the term only does again
        what the model does already.
    error, relative_error : "fit" and "validate" as the problem defines them; rms of the residuals where left out.
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

    @property
    def chi2(self) -> float:
        """Sum of squares over the fitted blocks."""
        return sum(block.chi2 for block in self.blocks)

    @property
    def chi2_held(self) -> float:
        """Sum of squares over the held-out blocks."""
        return sum(block.chi2 for block in self.held)

    @property
    def rows(self) -> int:
        """Rows of all fitted blocks."""
        return sum(block.residual.size for block in self.blocks)

    @property
    def dof(self) -> int:
        """Rows less free parameters and nuisances."""
        return self.rows - (self.jacobian[0].shape[1] if self.jacobian else 0) - self.nuisances

    def error_of(self, part: str) -> float | None:
        """The error on "fit" or "validate"; ``None`` without data of that kind, or with an unknown noise level."""
        if part in self.error:
            return self.error[part]
        blocks = self.blocks if part == "fit" else self.held
        if not blocks or not self.noise_known:
            return None
        return float(np.sqrt(sum(block.chi2 for block in blocks) / sum(block.residual.size for block in blocks)))


@dataclass(frozen=True)
class TermParameter:
    """A parameter of a candidate term.

    ``reach`` is the largest |value - null| of its declared range; ``side`` is +1 or -1 where the null is a boundary and
    only values above or below exist, else 0.
    """

    name: str
    unit: str = "1"
    null: float = 0.0
    reach: float = np.inf
    side: int = 0

    @classmethod
    def with_range(cls, name: str, unit: str, null: float, low: float, high: float) -> TermParameter:
        """A parameter with the declared range [low, high]."""
        side = 1 if low == null else (-1 if high == null else 0)
        return cls(name, unit, null, max(abs(high - null), abs(low - null)), side)


@dataclass(frozen=True)
class Candidate:
    """An absent term.

    Parameters
    ----------
    name : of the term.
    parameters : k of them, in the order of its columns.
    cells : the columns of Z that belong to each grid point, k each; one cell where nothing is scanned.
    grid : for each cell the values of the parameters that do not exist at the null.
    """

    name: str
    parameters: tuple[TermParameter, ...]
    cells: tuple[slice, ...]
    grid: tuple[Mapping[str, float], ...] = ({},)


@dataclass(frozen=True)
class LocalCandidate:
    """An absent term whose amplitudes are free in every block (lines of the mains).

    For each grid point the fall of chi2, which over its level of noise (1 where left out) is chi2 of ``dofs`` where the term
    does nothing; ``reach`` is the fall that could be expected of the strongest there may be.
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
    candidates : each with its cells of columns; columns that belong to none are allowed.
    blocks : for each fitted block Z_b (n m, K).
    local : candidates that are local to the blocks.
    grams : ``projection.stratum_grams`` of the blocks, where the problem keeps them.
    """

    candidates: tuple[Candidate, ...]
    blocks: tuple[FloatArray, ...]
    local: tuple[LocalCandidate, ...] = ()
    grams: FloatArray | None = None


@dataclass(frozen=True)
class Region:
    """A part of the data: where it is, its residual energy, and the degrees of freedom in it.

    ``family`` gathers regions that cut the data along one line (frequency, time, level); shares add up within one.
    ``robust`` is the same energy with single outliers clipped, for tests that heavy-tailed noise must not set off.
    """

    family: str
    labels: Mapping[str, object]
    chi2: float
    dof: float
    robust: float | None = None


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Residual energy by frequency, summed over all data that share the grid, where a single frequency may stand out.

    Parameters
    ----------
    frequency_hz, chi2 : (M,); neighbours may share energy.
    dof : degrees of freedom of each.
    """

    frequency_hz: FloatArray
    chi2: FloatArray
    dof: int


class Problem(Protocol):
    """A model and its data, as the loop sees them."""

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Fit the baseline with these terms, from several starts; ``ok`` is false where that failed."""
        ...

    def signatures(self, fit: FitResult) -> Signatures:
        """Candidates that the fit's model lacks, with their columns at their null."""
        ...

    def probes(self, fit: FitResult) -> Signatures:
        """Generic shapes that any misfit is likely to touch; they are never named.  May be empty."""
        ...

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """The residual energy, region by region.  May be empty."""
        ...

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """The residual energy of whole blocks by frequency, one for each grid.  May be empty."""
        ...
