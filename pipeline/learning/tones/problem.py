"""Sweeps and frequency responses as a ``Problem`` of criticism: a regression of their rows on the parameters of a model.

Shapes: N rows, S senses; blocks (n, 2 S) as in ``rows``; P free parameters.

Long because fits, their starts and their derived quantities share the cached model of all terms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...axial import wrap
from ...criticism.announce import announce_fit
from ...criticism.problem import FitResult, Region, Signatures, Spectrum
from ...criticism.regression import Regression, Term
from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.noise.tones import ToneNoise
from ...experiment.tones import ToneCampaign
from ...inference.general.scales import check_pickoff
from ...inference.modal.model import starting_values
from ...inference.tones.model import PHASE, ToneModel, differences, offset_names
from ...inference.tones.start import LinearModes, linear_modes_of
from ..campaign.rows import APART
from .rows import ToneRows
from .terms import even_parameters, sizes_of, term_names, tone_terms

#: chi2 per degree of freedom above which a nonlinear fit is tried from other starts: that of the plant, and narrower modes.
#: With one start the cubic stiffness of a wire in helium ends at 13.6 %.
_MISFIT, _NARROWER = 4.0, 0.85


class ToneProblem:
    """The ``Problem`` of one campaign of sweeps and frequency responses.  Fits are kept, because they are requested again.

    Parameters
    ----------
    campaign : with at least one record to fit.
    model : plant and effects to start from.
    noise : level of each row.

    Raises
    ------
    MeasurementError : too few rows, or modes that are not those of the plant.
    """

    def __init__(self, campaign: ToneCampaign, model: Model, noise: ToneNoise) -> None:
        check_pickoff(model, campaign.instrument)
        first = campaign.records[0]
        self.campaign, self.noise = campaign, noise
        self.model = model.with_channels(first.sense_v.shape[1], first.drive_v.shape[1])
        self.rows = ToneRows(campaign, noise)
        self._fits: dict[frozenset[str], FitResult] = {}

    @cached_property
    def linear(self) -> LinearModes:
        """The modes of a linear fit from which the plant starts."""
        plant = self.model.plant
        modes = 3 if plant.kind == "gyro" else plant.modes
        return linear_modes_of(self.campaign, modes, plant.kind == "modal" and plant.sense == "displacement")

    @cached_property
    def start(self) -> dict[str, float]:
        """Start values of all free parameters of the given model and of the detector."""
        tone = ToneModel(self.model, self.campaign)
        known = {**starting_values(self.model, self.linear.record), **self.model.fixed}
        plain = {name: p.null for name, p in self.model.parameters() if name not in known}
        detector = dict.fromkeys(tone.detector, 0.0)
        if PHASE in detector:
            detector[PHASE] = float(np.rad2deg(self.linear.phase))
        return {**plain, **known, **detector}

    @cached_property
    def _sizes(self) -> dict[str, float]:
        """Typical size of each parameter, for steps of differences."""
        largest = max(float(np.abs(record.sense_v).max()) for record in self.campaign.records)
        own = dict.fromkeys(offset_names(self.campaign.records[0].sense_v.shape[1]), 0.001 * largest)
        own |= {name: max(abs(self.start[name]), 1e-12) for name in self.start if name not in own}
        return {**own, PHASE: 1.0, **self._term_sizes, **{name: self._term_sizes[name] ** 2 for name in self._even}}

    @cached_property
    def _term_sizes(self) -> dict[str, float]:
        tone = ToneModel(self._full_model, self.campaign)
        return sizes_of(tone, term_names(self.model, tone.swept), self._at_null)

    @cached_property
    def _even(self) -> frozenset[str]:
        """Parameters of terms whose sign the records do not show; they are fitted as squares."""
        return even_parameters(ToneModel(self._full_model, self.campaign), self._term_sizes, self._at_null)

    @cached_property
    def _full_model(self) -> Model:
        """The model with every term; at their nulls they do nothing."""
        larger = self.model
        swept = ToneModel(self.model, self.campaign).swept
        for name in term_names(self.model, swept):
            larger = larger.with_effect(name)
        return larger

    @property
    def _at_null(self) -> dict[str, float]:
        """The start with every absent effect at its null, its scanned parameters at their first value."""
        full = self._full_model.by_name
        return {**{n: p.grid[0] if p.grid else p.null for n, p in full.items()}, **self.start}

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Absent effects that these records could show."""
        return tone_terms(self.model, self.campaign, self._term_sizes, self.tone.swept, self._even)

    @cached_property
    def tone(self) -> ToneModel:
        """The records as a function of the parameters of all terms."""
        return ToneModel(self._full_model, self.campaign, self._even)

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that do not change a steady response."""
        acting = {term.name for term in self.terms}
        return tuple(name for name in self.model.candidates() if name not in acting)

    @cached_property
    def _problem(self) -> Regression:
        plant = {p.name for p in self.model.built.parameters}
        limits = {n: (0.0, np.inf) for n in self.start if n.endswith("_hz")}
        limits |= {n: (1e-9, 0.95) for n in self.start if n.startswith("zeta") and n in plant}
        fixed = set(self.model.fixed)
        return Regression(
            self._predict,
            self.rows.measured,
            {name: value for name, value in self.start.items() if name not in fixed},
            self.terms,
            held=self.rows.held,
            scale=self._sizes,
            noise_known=self.noise.known,
            strata=self.rows.strata,
            limits=limits,
            slopes=self._slopes,
        )

    def predicted(self, fit: FitResult) -> tuple[ComplexArray, ...]:
        """Y (N, S) [V] of every record at the parameters of a fit."""
        return self.tone.predict(self._all(_values(self._squared(fit))))

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

    def _all(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**self._at_null, **values}

    def _predict(self, points: Sequence[Mapping[str, float]]) -> list[tuple[FloatArray, ...]]:
        found = []
        for values in points:
            try:
                found.append(self.rows.whitened(self.tone.predict(self._all(values))))
            except (GyroscreenError, np.linalg.LinAlgError):
                # No device has these parameters: a residual that no step accepts.
                found.append(tuple(np.full(block.residual.shape, 1e6) for block in self.rows.measured))
        return found

    def _slopes(self, values: Mapping[str, float], names: Sequence[str]) -> list[FloatArray]:
        columns = [self.rows.whitened(one) for one in differences(self.tone, self._all(values), names, self._sizes)]
        sizes = [block.residual.size for block in self.rows.measured]
        return [
            np.stack([column[b].reshape(-1) for column in columns], axis=1) if columns else np.zeros((size, 0))
            for b, size in enumerate(sizes)
        ]

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
            if own and self.noise.known
        }
        return replace(
            fit,
            derived=self._derived(fit),
            error=errors,
            relative_error=self.relative_errors(fit),
            noise_bounded=not self.noise.known,
            error_given=self.noise.independent,
            at_limit=tuple(name for name in fit.terms if self._duplicates(fit, name)),
        )

    def _derived(self, fit: FitResult) -> dict[str, tuple[float, float]]:
        """Full width at half power 2 zeta f [Hz] of each mode; theta and split of a gyro."""
        names, values = list(fit.parameters), _values(fit)
        covariance = _covariance(fit)

        def sd(gradient: Mapping[str, float]) -> float:
            g = np.array([gradient.get(name, 0.0) for name in names])
            return float(np.sqrt(max(float(g @ covariance @ g), 0.0)))

        found: dict[str, tuple[float, float]] = {}
        if {"f1_hz", "f2_hz", "theta_deg"} <= set(names):
            split = values["f2_hz"] - values["f1_hz"]
            found |= {"theta_deg": fit.parameters["theta_deg"], "split_hz": (split, sd({"f2_hz": 1.0, "f1_hz": -1.0}))}
        for name in names:
            zeta = f"zeta{name[1:-3]}"
            if name.endswith("_hz") and zeta in values:
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

    def relative_errors(self, fit: FitResult) -> dict[str, float]:
        """rms(measured - model) / rms(measured) [1] over the rows of each role, in volts."""
        predicted = self.predicted(fit)
        found = {}
        for role in ("fit", "validate"):
            pairs = [(r.sense_v, y) for r, y in zip(self.campaign.records, predicted) if (r.role or "fit") == role]
            if pairs:
                left = sum(float(np.sum(np.abs(measured - y) ** 2)) for measured, y in pairs)
                found[role] = float(np.sqrt(left / sum(float(np.sum(np.abs(measured) ** 2)) for measured, _ in pairs)))
        return found

    def signatures(self, fit: FitResult) -> Signatures:
        """Z by central differences at the null of every absent term.

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
        """Generic shapes of the fitted response."""
        return self.rows.probes(self.predicted(fit))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """The residual of each fitted pass and channel by frequency."""
        return self.rows.regions(fit)

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
