"""A campaign of records in time and in frequency as a ``Problem`` of criticism: one regression on the parameters of one device.

    r = (measured - model) / sd        the rows of all parts (``part``), each with its own noise, one after the other

Shapes: block b (n_b, m_b); P free parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, reduce

import numpy as np

from ...axial import wrap
from ...criticism.announce import announce_fit
from ...criticism.fit_tests import Rules
from ...criticism.problem import FitResult, Region, Signatures, Spectrum
from ...criticism.regression import Term
from ...criticism.selection import ForwardSelection, forward_selection
from ...criticism.verdict import TermClass
from ...device.model import Model
from ...errors import GyroscreenError
from ...inference.general.variation import RecordVariation
from ...inference.screening.dependent_noise import DependentNoise
from ..next_experiment.separating import Proposal
from .derived import derived_of, duplicates
from .part import Part, RecordLeft
from .rows import JointRows
from .terms import terms_of

#: chi2 per degree of freedom above which a nonlinear fit is tried from other starts: that of the plant, and narrower modes.
#: With one start the cubic stiffness of a wire in helium ends at 13.6 %.
_MISFIT, _NARROWER = 4.0, 0.85


class JointProblem:
    """The ``Problem`` of one campaign whose records are not all in the time domain.  Fits are kept.

    Parameters
    ----------
    parts : of the campaign, all with the same model; at least one has a record to fit.
    """

    #: Differences between the records, and noise that depends on the signal: of records in the time domain.
    variation: RecordVariation | None = None
    dependent: DependentNoise | None = None

    def __init__(self, parts: tuple[Part, ...]) -> None:
        self._plain = parts
        self.model: Model = parts[0].model
        self._fits: dict[frozenset[str], FitResult] = {}

    @cached_property
    def rows(self) -> JointRows:
        """The rows beside the given model, for squares of the parameters whose sign does not show."""
        return JointRows(
            tuple(part.with_even(self._even) for part in self._plain),
            self._at_null,
            {name: value for name, value in self.start.items() if name not in self._fixed},
            self.terms,
            self._term_sizes,
            self._even,
            self._limits,
        )

    def selected(self, rules: Rules) -> tuple[JointProblem, ForwardSelection]:
        """The selection of effects, and the problem on which it was made."""
        return self, forward_selection(self, (), rules)

    def proposal(self, terms: Sequence[str], found: TermClass) -> Proposal | None:
        """The record that would separate the members of a class beside ``terms``; none, because drive files are in time."""
        return None

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts beside the given model."""
        return self.rows.parts

    def rows_of(self, terms: Sequence[str], start: FitResult | None = None) -> JointRows:
        """The rows of a fit with ``terms``, which begins at ``start``."""
        return self.rows

    def parts_of(self, fit: FitResult) -> tuple[Part, ...]:
        """The parts that a fit explains."""
        return self.rows_of(fit.terms).parts

    @cached_property
    def _fixed(self) -> dict[str, float]:
        """Parameters that no part can show, and those that the model fixes."""
        every = [part.fixed() for part in self._plain]
        common = reduce(lambda a, b: {n: v for n, v in a.items() if n in b}, every)
        return {**common, **self.model.fixed}

    @cached_property
    def start(self) -> dict[str, float]:
        """Start values of all free parameters of the given model and of the instruments."""
        best = max(self._plain, key=lambda part: part.shows_gains)
        found = {**best.plant_start(), **self._fixed}
        known = {**{name: p.null for name, p in self.model.parameters() if name not in found}, **found}
        return reduce(lambda values, part: {**values, **part.own_start(values)}, self._plain, known)

    @cached_property
    def _term_sizes(self) -> list[dict[str, float]]:
        """For each part the sizes of the parameters of terms."""
        return [part.sizes(part.effects, self._at_null) for part in self._plain]

    @cached_property
    def _even(self) -> frozenset[str]:
        """Parameters of terms whose sign the records do not show; they are fitted as squares."""
        every = [part.even_parameters(own, self._at_null) for part, own in zip(self._plain, self._term_sizes)]
        shown = {name for even, own in zip(every, self._term_sizes) for name in own if name not in even}
        return frozenset({name for even in every for name in even} - shown)

    @property
    def _at_null(self) -> dict[str, float]:
        """The start with every absent effect at its null, parameters that do not exist there at the first value of their grid."""
        full, found = self._plain[0].full, {name: p.null for name, p in self._plain[0].full.by_name.items()}
        for effect in full.ordered_effects():
            members = effect.members(full.built.shape)
            # A clip level alone is an effect, at any value but its null.
            if not all(m.grid for m in members):
                found |= {effect.full_name(m): m.grid[0] for m in members if m.grid}
        return {**found, **self.start}

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Absent effects that these records could show."""
        return terms_of(self.model, self._plain, {n for own in self._term_sizes for n in own}, self._even)

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that do not change these records."""
        acting = {term.name for term in self.terms}
        return tuple(name for name in self.model.candidates(True) if name not in acting)

    @property
    def _limits(self) -> dict[str, tuple[float, float]]:
        plant = {p.name for p in self.model.built.parameters}
        limits = {n: (0.0, np.inf) for n in self.start if n.endswith("_hz") or n.startswith("floor_")}
        limits |= {n: (1e-9, 0.95) for n in self.start if n.startswith("zeta") and n in plant}
        limits |= {effect.mode[1]: (1e-9, 0.95) for effect in self.model.library.values() if effect.mode is not None}
        return limits | {name: self._plain[0].full.bounds(name) for part in self._plain for name in part.ranged}

    @property
    def noise_known(self) -> bool:
        """Whether the noise of every part was measured."""
        return all(part.noise.known for part in self._plain)

    @property
    def noise_independent(self) -> bool:
        """Whether the noise of every part was measured on other data than its rows."""
        return all(part.noise.independent for part in self._plain)

    @property
    def noise_dof(self) -> float:
        """Degrees of freedom of the least certain noise level."""
        return min(part.noise.dof for part in self._plain)

    def values(self, fit: FitResult) -> dict[str, float]:
        """All parameters at a fit, as the parts take them."""
        return {**self._at_null, **_values(self._squared(fit))}

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Least squares of the model with these terms, from ``start``; ``ok`` is false where no fit succeeded."""
        key = frozenset(terms)
        if key not in self._fits:
            announce_fit(terms)
            try:
                self._fits[key] = self._completed(self._rooted(self._best(terms, start)))
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
        return self._fits[key]

    def _best(self, terms: tuple[str, ...], start: FitResult | None) -> FitResult:
        """The fit, and where jumps of a nonlinear response leave a misfit the best of fits from other starts as well.

        chi2 is not smooth where a row changes its branch, so that a fit may end between two jumps.
        """
        regression = self.rows_of(terms, start).regression
        best = regression.fit(terms, None if start is None else self._squared(start))
        library = self.model.library
        nonlinear = any(n in library and library[n].force for n in (*self.model.effects, *terms))
        for first in (None, _narrower):
            if not (nonlinear and best.jacobian and best.chi2 > _MISFIT * max(best.dof, 1)):
                break
            again = regression.fit(terms, None if first is None else first(best))
            best = again if again.ok and (again.chi2 < best.chi2 or not best.ok) else best
        return best

    def _completed(self, fit: FitResult) -> FitResult:
        """The fit with derived quantities, errors by role, and what the noise level allows to say."""
        if not fit.jacobian:
            return fit
        parameters = dict(fit.parameters)
        if "theta_deg" in parameters:
            parameters["theta_deg"] = (float(wrap(parameters["theta_deg"][0])), parameters["theta_deg"][1])
        fit = replace(fit, parameters=parameters)
        blocks = {"fit": fit.blocks, "validate": fit.held}
        errors = {
            role: float(np.sqrt(sum(b.chi2 for b in own) / sum(b.residual.size for b in own)))
            for role, own in blocks.items()
            if own and self.noise_known
        }
        return replace(
            fit,
            derived=derived_of(fit, self._fixed),
            error=errors,
            relative_error=self.relative_errors(fit),
            noise_bounded=not self.noise_known,
            error_given=self.noise_independent,
            at_limit=tuple(name for name in fit.terms if duplicates(fit, name, self.model)),
        )

    def _squared(self, fit: FitResult) -> FitResult:
        """The fit with the squares of the parameters whose sign does not show, as the regression has them."""
        squares = {
            name: (v**2, 2.0 * v * sd) if name in self._even else (v, sd) for name, (v, sd) in fit.parameters.items()
        }
        return replace(fit, parameters=squares)

    def _rooted(self, fit: FitResult) -> FitResult:
        """The inverse of ``_squared``; a root at zero has no sd."""
        roots = {
            name: (np.sqrt(max(v, 0.0)), sd / (2.0 * np.sqrt(v)) if v > 0.0 else np.nan)
            if name in self._even
            else (v, sd)
            for name, (v, sd) in fit.parameters.items()
        }
        return replace(fit, parameters=roots)

    def left(self, fit: FitResult) -> list[RecordLeft]:
        """What the model of a fit leaves of each record."""
        return [one for own in self._left(fit) for one in own]

    def _left(self, fit: FitResult) -> list[list[RecordLeft]]:
        return self.rows_of(fit.terms).left(self.values(fit))

    def relative_errors(self, fit: FitResult) -> dict[str, float]:
        """rms(measured - model) / rms(measured) [1] over the records of each role in volts; its rms over the parts."""
        found = {}
        for role in ("fit", "validate"):
            shares = []
            for part in self._left(fit):
                own = [one for one in part if one.role == role]
                if own:
                    left, power = (sum(getattr(one, what) * one.size for one in own) for what in ("left", "power"))
                    shares.append(left / max(power, 1e-300))
            if shares:
                found[role] = float(np.sqrt(np.mean(shares)))
        return found

    def signatures(self, fit: FitResult) -> Signatures:
        """Z by differences at the null of every absent term.

        A term whose sign does not show, such as a quadratic stiffness, acts on a tone like a softening cubic one, to second
        order (Nayfeh and Mook 1979, section 4.1).  It is a candidate beside a nonlinear force only, so that it is named as
        the rival of that force and not in its place.
        """
        found = self.rows_of(fit.terms).regression.signatures(self._squared(fit))
        library = self.model.library
        if any(name in library and library[name].force for name in (*self.model.effects, *fit.terms)):
            return found
        candidates = (one for one in found.candidates if not any(p.name in self._even for p in one.parameters))
        return replace(found, candidates=tuple(candidates))

    def probes(self, fit: FitResult) -> Signatures:
        """Generic shapes of each part."""
        return self.rows_of(fit.terms).probes(self.values(fit))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """Small regions of the fitted residual of each part."""
        return self._regions(fit, "regions")

    def misfit_regions(self, fit: FitResult) -> list[Region]:
        """The fitted residual of each part by every family of the answer."""
        pooled: dict[tuple[str, str], Region] = {}
        for one in self._regions(fit, "misfit_regions"):
            key = one.family, repr(one.labels)
            known = pooled.get(key)
            pooled[key] = one if known is None else replace(known, chi2=known.chi2 + one.chi2, dof=known.dof + one.dof)
        return list(pooled.values())

    def _regions(self, fit: FitResult, what: str) -> list[Region]:
        return self.rows_of(fit.terms).regions(fit, self.values(fit), what)

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Empty: the rows of a sweep are no spectrum of a record."""
        return ()


def _narrower(fit: FitResult) -> FitResult:
    """The fit with smaller dampings of the plant, as a start."""
    moved = {n: (v * _NARROWER if n.startswith("zeta") else v, sd) for n, (v, sd) in fit.parameters.items()}
    return replace(fit, parameters=moved)


def _values(fit: FitResult) -> dict[str, float]:
    return {name: value for name, (value, _) in fit.parameters.items()}
