"""A campaign of records in time and in frequency as a ``Problem`` of criticism: one regression on the parameters of one device.

    r = (measured - model) / sd        the rows of all parts (``part``), each with its own noise, one after the other

Long because fits, their starts and their derived quantities share the cached model of all terms.

Shapes: block b (n_b, m_b); P free parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from typing import TypeVar

import numpy as np

from ...arrays import FloatArray, IntArray
from ...axial import wrap
from ...criticism.announce import announce_fit
from ...criticism.problem import Candidate, FitResult, Region, Signatures, Spectrum
from ...criticism.regression import Regression, Term
from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.tones import ToneCampaign
from ..campaign.rows import APART
from .part import Part, RecordLeft
from .parts import parts_of
from .terms import terms_of

T = TypeVar("T")

#: chi2 per degree of freedom above which a nonlinear fit is tried from other starts: that of the plant, and narrower modes.
#: With one start the cubic stiffness of a wire in helium ends at 13.6 %.
_MISFIT, _NARROWER = 4.0, 0.85


class JointProblem:
    """The ``Problem`` of one campaign whose records are not all in the time domain.  Fits are kept.

    Parameters
    ----------
    campaign : with at least one record to fit.
    model : plant and effects to start from.

    Raises
    ------
    MeasurementError : too few rows, modes that are not those of the plant, or a noise level that cannot be measured.
    """

    def __init__(self, campaign: ToneCampaign, model: Model) -> None:
        self.campaign = campaign
        self._plain = parts_of(campaign, model)
        self.model = self._plain[0].model
        self._fits: dict[frozenset[str], FitResult] = {}

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The parts, for squares of the parameters whose sign does not show."""
        return tuple(part.with_even(self._even) for part in self._plain)

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
        """The start with every absent effect at its null, its scanned parameters at their first value."""
        full = self._plain[0].full.by_name
        return {**{n: p.grid[0] if p.grid else p.null for n, p in full.items()}, **self.start}

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Absent effects that these records could show."""
        return terms_of(self.model, self._plain, {n for own in self._term_sizes for n in own}, self._even)

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that do not change these records."""
        acting = {term.name for term in self.terms}
        return tuple(name for name in self.model.candidates(True) if name not in acting)

    @cached_property
    def _problem(self) -> Regression:
        plant = {p.name for p in self.model.built.parameters}
        limits = {n: (0.0, np.inf) for n in self.start if n.endswith("_hz")}
        limits |= {n: (1e-9, 0.95) for n in self.start if n.startswith("zeta") and n in plant}
        limits |= {n: (0.0, np.inf) for n in self.start if n.startswith("floor_")}
        limits |= {name: self._plain[0].full.bounds(name) for part in self._plain for name in part.ranged}
        return Regression(
            self._predict,
            self._in_order([part.measured for part in self._plain]),
            {name: value for name, value in self.start.items() if name not in self._fixed},
            self.terms,
            held=sum(part.held for part in self._plain),
            noise_known=self.noise_known,
            strata=self._strata,
            limits=limits,
            slopes=self._slopes,
        )

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

    @property
    def _strata(self) -> tuple[IntArray, ...]:
        """Parts have strata of their own."""
        found: list[IntArray] = []
        first = 0
        for part in self._plain:
            found += [own + first for own in part.strata]
            first += 1 + max((int(own.max(initial=0)) for own in part.strata), default=-1)
        return tuple(found)

    def _in_order(self, each: Sequence[Sequence[T]]) -> tuple[T, ...]:
        """Blocks of all parts, fitted ones first."""
        fitted = [one for own, part in zip(each, self._plain) for one in own[: len(own) - part.held]]
        held = [one for own, part in zip(each, self._plain) for one in own[len(own) - part.held :]]
        return (*fitted, *held)

    def values(self, fit: FitResult) -> dict[str, float]:
        """All parameters at a fit, as the parts take them."""
        return self._all(_values(self._squared(fit)))

    def _all(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**self._at_null, **values}

    def _predict(self, points: Sequence[Mapping[str, float]]) -> list[tuple[FloatArray, ...]]:
        found = []
        for values in points:
            try:
                found.append(self._in_order([part.predict(self._all(values)) for part in self.parts]))
            except (GyroscreenError, np.linalg.LinAlgError):
                # No device has these parameters: a residual that no step accepts.
                found.append(tuple(np.full(block.residual.shape, 1e6) for block in self._problem.measured))
        return found

    def _slopes(self, values: Mapping[str, float], names: Sequence[str]) -> list[FloatArray]:
        every, own = self._all(values), {name: max(abs(self.start[name]), 1e-12) for name in self.start}
        found = []
        for part, sizes in zip(self.parts, self._term_sizes):
            typical = {**own, **sizes, **{name: sizes[name] ** 2 for name in self._even if name in sizes}}
            found.append(part.slopes(every, names, typical))
        return list(self._in_order(found))

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
        best = self._problem.fit(terms, None if start is None else self._squared(start))
        library = self.model.library
        nonlinear = any(n in library and library[n].force for n in (*self.model.effects, *terms))
        for first in (None, _narrower):
            if not (nonlinear and best.jacobian and best.chi2 > _MISFIT * max(best.dof, 1)):
                break
            again = self._problem.fit(terms, None if first is None else first(best))
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
            derived=self._derived(fit),
            error=errors,
            relative_error=self.relative_errors(fit),
            noise_bounded=not self.noise_known,
            error_given=self.noise_independent,
            at_limit=tuple(name for name in fit.terms if self._duplicates(fit, name)),
        )

    def _derived(self, fit: FitResult) -> dict[str, tuple[float, float]]:
        """Full width at half power 2 zeta f [Hz] of each mode; theta and split of a gyro."""
        names, values = list(fit.parameters), {**self._fixed, **_values(fit)}
        covariance = _covariance(fit)

        def sd(gradient: Mapping[str, float]) -> float:
            g = np.array([gradient.get(name, 0.0) for name in names])
            return float(np.sqrt(max(float(g @ covariance @ g), 0.0)))

        found: dict[str, tuple[float, float]] = {}
        if {"f1_hz", "f2_hz", "theta_deg"} <= set(names):
            split = values["f2_hz"] - values["f1_hz"]
            found |= {"theta_deg": fit.parameters["theta_deg"], "split_hz": (split, sd({"f2_hz": 1.0, "f1_hz": -1.0}))}
        for name in values:
            zeta = f"zeta{name[1:-3]}"
            if name.endswith("_hz") and zeta in fit.parameters:
                f, z = values[name], values[zeta]
                found[f"width{name[1:-3]}_hz"] = (2.0 * z * f, sd({name: 2.0 * z, zeta: 2.0 * f}))
        return found

    def _duplicates(self, fit: FitResult, term: str) -> bool:
        """Whether a term adds a mode in the resonance of a plant mode."""
        mode = self.model.library[term].mode if term in self.model.library else None
        values = _values(fit)
        if mode is None or mode[0] not in values:
            return False
        f, zeta = values[mode[0]], values.get(mode[1], 0.0)
        others = [
            (values[n], values[f"zeta{n[1:-3]}"]) for n in values if f"zeta{n[1:-3]}" in values and n.endswith("_hz")
        ]
        return any(abs(f - own) < APART * (zeta * f + z * own) for own, z in others)

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
        values = self.values(fit)
        return [part.left(values) for part in self.parts]

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
        found = self._problem.signatures(self._squared(fit))
        library = self.model.library
        if any(name in library and library[name].force for name in (*self.model.effects, *fit.terms)):
            return found
        candidates = (one for one in found.candidates if not any(p.name in self._even for p in one.parameters))
        return replace(found, candidates=tuple(candidates))

    def probes(self, fit: FitResult) -> Signatures:
        """Generic shapes of each part; those of one part are zero in the others."""
        values, candidates = self.values(fit), list[Candidate]()
        every = [part.probes(values) for part in self.parts]
        width = sum(own.blocks[0].shape[1] for own in every if own.blocks)
        blocks, first = [], 0
        for part, own in zip(self.parts, every):
            for z in own.blocks:
                wide = np.zeros((z.shape[0], width))
                wide[:, first : first + z.shape[1]] = z
                blocks.append(wide)
            for one in own.candidates:
                cells = tuple(slice(c.start + first, c.stop + first) for c in one.cells)
                candidates.append(replace(one, name=f"{part.kind}: {one.name}", cells=cells))
            first += own.blocks[0].shape[1] if own.blocks else 0
        return Signatures(tuple(candidates), tuple(blocks))

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
        values, per_row = self.values(fit), fit.dof / max(fit.rows, 1)
        found: list[Region] = []
        first = 0
        for part in self.parts:
            count = len(part.measured) - part.held
            found += getattr(part, what)(fit.blocks[first : first + count], values, per_row)
            first += count
        return found

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Empty: the rows of a sweep are no spectrum of a record."""
        return ()


def _narrower(fit: FitResult) -> FitResult:
    """The fit with smaller dampings of the plant, as a start."""
    moved = {n: (v * _NARROWER if n.startswith("zeta") else v, sd) for n, (v, sd) in fit.parameters.items()}
    return replace(fit, parameters=moved)


def _values(fit: FitResult) -> dict[str, float]:
    return {name: value for name, (value, _) in fit.parameters.items()}


def _covariance(fit: FitResult) -> FloatArray:
    """(P, P) of the free parameters in their units, at the noise level of the rows or, where it is unknown, of the residual."""
    gram = sum((jac.T @ jac for jac in fit.jacobian), np.zeros((fit.jacobian[0].shape[1],) * 2))
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    level = 1.0 if fit.noise_known else fit.chi2 / max(fit.dof, 1)
    return np.asarray(np.linalg.pinv(gram / np.outer(size, size), hermitian=True) / np.outer(size, size) * level)
