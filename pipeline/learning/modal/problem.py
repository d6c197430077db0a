"""A modal record as a ``Problem`` of criticism: a regression of its rows on the parameters of a model.

    relative_error^2 = 1/M sum_m |c_m - c_m(model)|^2 / |c_m|^2

With a declared noise, error = sqrt(chi2 / degrees of freedom), because the rows are so few that the number of parameters
matters.  The frequencies and damping ratios of the plant fit any poles, so poles carry no information until an effect relates
them to the residues.

Shapes: M modes, S senses, D drives; one block of n rows (see ``rows``); P free parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...axial import wrap
from ...criticism.announce import announce_fit
from ...criticism.problem import FitResult, Region, ResidualBlock, Signatures, Spectrum
from ...criticism.regression import Regression, Term
from ...device.model import Model
from ...device.parameters import Parameter
from ...errors import ConfigError, GyroscreenError
from ...experiment.files.modal_record import ModalRecord
from ...inference.general.gauss_newton import ITERATIONS
from ...inference.modal.axes import FourThetas, four_thetas
from ...inference.modal.model import ResonantModes, modelled_modes, starting_values, systems_of
from ..campaign.rows import USABLE
from ..common import GAUGES
from .rows import POLE_WEIGHT, ModalRows
from .terms import declared_terms, modal_terms


class ModalProblem:
    """The ``Problem`` of one modal record.  Fits are kept, because they are requested again.

    Parameters
    ----------
    record : poles and residues.
    model : plant and effects to start from.
    pole_weight : sd of a pole in half-widths, relative to the relative sd of its residues; 0.01 nearly fixes the poles.

    Raises
    ------
    MeasurementError : the record has too few modes, or not those of the plant.
    """

    def __init__(self, record: ModalRecord, model: Model, pole_weight: float = POLE_WEIGHT) -> None:
        self.record = record
        self.model = model.with_channels(record.R1.shape[1], record.R1.shape[2])
        self.rows = ModalRows(record, pole_weight)
        self.noise_known = record.sd is not None
        start = {**starting_values(self.model, record), **self.model.fixed}
        nulls = {name: p.null for name, p in self.model.parameters() if name not in start}
        self._start = {**nulls, **start}
        self._fits: dict[frozenset[str], FitResult] = {}

    @property
    def measured(self) -> ResonantModes:
        """Poles [rad/s] and residues at resonance (M, S, D) [1/s] of the record."""
        return self.rows.measured

    @property
    def norms(self) -> FloatArray:
        """(M,) norm of the measured residues of each mode [1/s]."""
        return self.rows.norms

    @cached_property
    def declared(self) -> tuple[str, ...]:
        """Absent effects that a declared condition fixes."""
        return declared_terms(self.model, self.rows)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Absent effects that change poles or residues."""
        return modal_terms(self.model, self.rows, self._start, self._start_modes, self.declared)

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that change neither poles nor residues, then the known gauge freedoms."""
        acting = {term.name for term in self.terms} | set(self.declared)
        gauges = GAUGES if self.model.plant.kind == "gyro" else ()
        return (*(name for name in self.model.candidates() if name not in acting), *gauges)

    @cached_property
    def _start_modes(self) -> ResonantModes:
        return modelled_modes(self.model, [self.model.complete(self._start)], self.record, self.measured.poles)[0]

    @cached_property
    def _full_model(self) -> Model:
        """The model with every term; at their nulls they do nothing."""
        larger = self.model
        for term in self.terms:
            larger = larger.with_effect(term.name)
        return larger

    @cached_property
    def _held(self) -> dict[str, float]:
        """Parameters of terms that a fit does not move."""
        scans = (item for term in self.terms for item in (term.scanned or {}).items())
        return {name: tried[0] for name, tried in scans if len(tried) == 1}

    def modes(self, values: Mapping[str, float]) -> ResonantModes:
        """Poles [rad/s] and residues at resonance (M, S, D) [1/s] of the model; absent effects are at their nulls.

        Raises
        ------
        ConfigError : parameters that no device can have.
        """
        return self._modes_at([values])[0]

    def _modes_at(self, points: Sequence[Mapping[str, float]]) -> tuple[ResonantModes, ...]:
        known = [self._full_model.complete({**self._held, **values}) for values in points]
        return modelled_modes(self._full_model, known, self.record, self.measured.poles)

    def _rows(self, modes: ResonantModes) -> FloatArray:
        return self.rows.rows(modes, self._start_modes.present)

    def _predict(self, points: Sequence[Mapping[str, float]]) -> list[tuple[FloatArray, ...]]:
        try:
            return [(self._rows(modes),) for modes in self._modes_at(points)]
        except ConfigError:
            return [(self._rows(self.modes(self._possible(values))),) for values in points]

    def _possible(self, values: Mapping[str, float]) -> dict[str, float]:
        """``values`` if a device can have them, else the last possible ones on the line from the nulls of the effects.

        A fit can then move along the boundary, such as abs(c12) = sqrt(c11 c22), instead of stopping at it.
        """
        inside, outside = 0.0, 1.0
        nulls = {name: self._full_model.by_name[name].null for name in values if name not in self._plant_names}

        def at(share: float) -> dict[str, float]:
            return {**values, **{name: null + share * (values[name] - null) for name, null in nulls.items()}}

        if self._exists(values):
            return dict(values)
        for _ in range(ITERATIONS):
            middle = (inside + outside) / 2.0
            inside, outside = (middle, outside) if self._exists(at(middle)) else (inside, middle)
        return at(inside)

    def _exists(self, values: Mapping[str, float]) -> bool:
        try:
            systems_of(self._full_model, [self._full_model.complete({**self._held, **values})], self.record)
        except ConfigError:
            return False
        return True

    @cached_property
    def _plant_names(self) -> frozenset[str]:
        return frozenset(p.name for p in self.model.built.parameters)

    @cached_property
    def _problem(self) -> Regression:
        known = {name: p for name, p in self._full_model.parameters() if name in self._full_model.free}
        return Regression(
            self._predict,
            (ResidualBlock(self.record.name, self._rows(self.measured)),),
            {name: self._start[name] for name in self.model.free},
            self.terms,
            scale={name: self._scale(name, p) for name, p in known.items()},
            noise_known=self.noise_known,
            limits={name: (p.low, p.high) for name, p in known.items() if p.unit != "deg"},
        )

    def _scale(self, name: str, parameter: Parameter) -> float:
        """The unit of the steps of a parameter; for a damping ratio its value, because it cannot become negative."""
        if name not in self._plant_names:
            return parameter.scale
        return abs(self._start[name]) if name.startswith("zeta") else max(abs(self._start[name]), 1e-2)

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Least squares of the model with these terms, from ``start``.

        Where the fit raises a GyroscreenError or LinAlgError, ``ok`` is false and ``why`` is its message.
        """
        key = frozenset(terms)
        if key not in self._fits:
            announce_fit(terms)
            try:
                self._fits[key] = self._completed(self._best(terms, start))
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
        return self._fits[key]

    def _best(self, terms: tuple[str, ...], start: FitResult | None) -> FitResult:
        """A fit that ends beyond the boundary may have missed a minimum inside: a second one then starts inside."""
        found = self._problem.fit(terms, start)
        values = _values(found)
        possible = self._possible(values) if found.jacobian else values
        if possible == values:
            return found
        inside = {name: (v if name in self._plant_names else USABLE * v, np.nan) for name, v in possible.items()}
        again = self._problem.fit(terms, replace(found, parameters=inside))
        return again if again.ok and again.chi2 < found.chi2 else found

    def _completed(self, fit: FitResult) -> FitResult:
        """The fit with theta wrapped to an axis, theta and split with their sd, error and relative error."""
        if not fit.jacobian:
            return fit
        # Beyond the boundary the last possible value is given, without an sd.
        possible = self._possible(_values(fit))
        parameters = {
            n: (v, sd) if v == possible[n] else (possible[n], np.nan) for n, (v, sd) in fit.parameters.items()
        }
        fit, derived = replace(fit, parameters=parameters), {}
        if "theta_deg" in parameters:
            value, sd = parameters["theta_deg"]
            parameters["theta_deg"] = derived["theta_deg"] = (float(wrap(value)), sd)
        names = list(parameters)
        if {"f1_hz", "f2_hz"} <= parameters.keys():
            gradient = np.zeros(len(names))
            gradient[names.index("f2_hz")], gradient[names.index("f1_hz")] = 1.0, -1.0
            split = parameters["f2_hz"][0] - parameters["f1_hz"][0]
            variance = max(float(gradient @ self.covariance(fit) @ gradient), 0.0)
            derived["split_hz"] = (split, float(np.sqrt(variance)))
        return replace(
            fit,
            parameters=parameters,
            derived=derived,
            error={"fit": float(np.sqrt(fit.chi2 / max(fit.dof, 1)))} if self.noise_known else {},
            relative_error={"fit": self.relative_error(fit)},
        )

    def covariance(self, fit: FitResult) -> FloatArray:
        """(P, P) of the free parameters, level^2 (J' J)^-1 in their units; level: 1, or sqrt(chi2/dof) if not declared."""
        jacobian = fit.jacobian[0]
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        gram = (jacobian / scale).T @ (jacobian / scale)
        return np.asarray(np.linalg.pinv(gram, hermitian=True) / np.outer(scale, scale) * self._level(fit) ** 2)

    def _level(self, fit: FitResult) -> float:
        """Sd of a row: 1 if the noise is known, else estimated from the residual."""
        return 1.0 if self.noise_known else float(np.sqrt(fit.chi2 / max(fit.dof, 1)))

    def relative_sd(self, fit: FitResult) -> FloatArray:
        """(M,) sd of the real or imaginary part of an entry, in units of the norm of its mode [1]."""
        return self.rows.relative_unit * self._level(fit)

    def noise(self, fit: FitResult) -> tuple[FloatArray, FloatArray]:
        """sd of R1 and R0 / w (M, 2, S, D) [1/s], and of Re p and Im p (M,) [rad/s]."""
        return self.rows.unit * self._level(fit), self.rows.pole_unit * self._level(fit)

    def residuals(self, fit: FitResult) -> ComplexArray:
        """(M, S, D) c - c(model), in units of the norm of each mode [1]."""
        return np.asarray((self.measured.c - self.modes(_values(fit)).c) / self.norms[:, None, None])

    def relative_error(self, fit: FitResult) -> float:
        """sqrt(mean over modes of |c - c(model)|^2 / |c|^2) of the residues at resonance [1]."""
        return float(np.sqrt(np.sum(np.abs(self.residuals(fit)) ** 2) / self.norms.size))

    def thetas(self, fit: FitResult) -> FourThetas | None:
        """The four thetas of the paper, after the effects of the fit are removed; ``None`` if its route does not apply."""
        if self.model.plant.kind != "gyro":
            return None
        plant = replace(self.model, effects=(), fixed={}, prior={})
        own = {p.name: _values(fit).get(p.name, self._start[p.name]) for p in plant.built.parameters}
        bare = modelled_modes(plant, [plant.complete(own)], self.record, self.measured.poles)[0]
        try:
            return four_thetas(self.record, self.modes(_values(fit)).c - bare.c, self.noise(fit)[0])
        except GyroscreenError:
            return None

    def signatures(self, fit: FitResult) -> Signatures:
        """Z (n, K) by central differences at the null of every absent term."""
        return self._problem.signatures(fit)

    def probes(self, fit: FitResult) -> Signatures:
        """(n, K): any change of the residues of one mode, and of all modes: a test of the whole residual."""
        return self.rows.probes(self._rows(self.measured).size)

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """The residual energy of each of the M S D entries."""
        return self.rows.regions(fit)

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """Empty: a modal record has no spectrum besides its modes."""
        return ()


def _values(fit: FitResult) -> dict[str, float]:
    return {name: value for name, (value, _) in fit.parameters.items()}
