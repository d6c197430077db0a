"""A modal record as criticism sees it: rows of residues and poles, candidates that act on them, what cannot be seen.

    residues   (c_m - c_m(model)) / |c_m|_F                  Re and Im of every entry; c = i R1 + R0 / w
    poles      (p_m - p_m(model)) / (sqrt 2 |Re p_m|)        Re and Im

Both in one unit, the relative sd r of a mode's entries: whoever finds residues to r finds the pole to sqrt 2 r of a half
width (Cramer-Rao bound of a decaying exponential in white noise, one channel).  With declared ``sd`` a residue's rows are
divided by it instead, and a pole's by sqrt 2 |Re p_m| rms(sd) / |c_m|_F; then the noise is known.

With so few rows a declared noise gives error = sqrt(chi2 / degrees of freedom): 1.0 is explained, however many parameters.

The plant's frequencies and damping ratios fit any poles, so poles weigh nothing until an effect ties the residues to them.

    relative_error^2 = 1/M sum_m |c_m - c_m(model)|^2 / |c_m|^2

Shapes: M modes, S senses, D drives; one block of 2 M S D + 2 (modes of the plant) rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...axial import wrap
from ...criticism.problem import Candidate, FitResult, Region, ResidualBlock, Signatures, Spectrum, TermParameter
from ...criticism.regression import Regression, Term
from ...device.effect import Effect
from ...device.model import Model
from ...device.parameters import Parameter
from ...errors import ConfigError, GyroscreenError
from ...experiment.files.modal_record import ModalRecord
from ...inference.modal.axes import FourThetas, four_thetas
from ...inference.modal.model import ResonantModes, conditions, measured_modes, modelled_modes, starting_values

#: Degeneracies of plant "gyro" that no linear experiment can lift.
GAUGES = (
    "drive and sense electrodes turned together (moves theta 1:1)",
    "up-down tilt about the other axis (updown_gain takes it)",
    "linear part of electrostatic softening (frequencies and theta take it)",
)
#: sd of a pole in half widths over the relative sd of its residues.
POLE_WEIGHT = float(np.sqrt(2.0))
#: Steps of differences are 1e-5 of this many scales of a parameter.
_SCALES = 100.0
#: Residues and poles that move by a smaller share for a step of one scale do not see the effect.
_NOTHING = 1e-9
#: Of the way to the edge of what can be.
_BISECTIONS = 24
_INSIDE = 0.9
_ANGLES = (-90.0, -45.0, 0.0, 45.0, 90.0)


class ModalProblem:
    """The ``Problem`` of one modal record; fits are kept, for they are asked for again.

    Parameters
    ----------
    record : poles and residues.
    model : plant and effects to start from.
    pole_weight : sd of a pole in half widths over the relative sd of its residues; 0.01 as good as holds the poles.
    """

    def __init__(self, record: ModalRecord, model: Model, pole_weight: float = POLE_WEIGHT) -> None:
        self.record = record
        self.model = model.with_channels(record.R1.shape[1], record.R1.shape[2])
        self.measured = measured_modes(record)
        self.pole_weight = pole_weight
        self.noise_known = record.sd is not None
        self.norms: FloatArray = np.linalg.norm(self.measured.c, axis=(1, 2))
        start = {**starting_values(self.model, record), **self.model.fixed}
        nulls = {name: p.null for name, p in self.model.parameters() if name not in start}
        self._start = {**nulls, **start}
        self._fits: dict[frozenset[str], FitResult] = {}

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Absent effects that move poles or residues."""
        found = (self._term(self.model.library[name]) for name in self.model.candidates())
        return tuple(term for term in found if term is not None)

    @cached_property
    def declared(self) -> tuple[str, ...]:
        """Absent effects that a declared condition fixes."""
        known = conditions(self.record).rate is not None
        return tuple(n for n in self.model.candidates() if known and self.model.library[n].condition == "rate")

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that leave poles and residues alone, then the known gauges."""
        seen = {term.name for term in self.terms} | set(self.declared)
        gauges = GAUGES if self.model.plant.kind == "gyro" else ()
        return (*(name for name in self.model.candidates() if name not in seen), *gauges)

    def _term(self, effect: Effect) -> Term | None:
        """The effect as a term; ``None`` where it is fixed by a condition or moves nothing that the record holds."""
        if effect.name in self.declared or not {"mechanics", "readout"} & set(effect.stages):
            return None
        larger = self.model.with_effect(effect.name)
        members = effect.members(self.model.built.shape)
        plain = [m for m in members if not m.grid]
        scanned = {effect.full_name(m): m.grid for m in members if m.grid}
        sizes = {effect.full_name(m): m.null + m.scale for m in plain}
        try:
            trial = larger.complete({**self._start, **sizes, **{name: tried[0] for name, tried in scanned.items()}})
            there = modelled_modes(larger, trial, self.record, self.measured.poles)
        except ConfigError:
            return None
        moved = (
            np.abs(there.c - self._here.c).max() / self.norms.max(),
            np.abs(there.poles / self._here.poles - 1.0).max(),
        )
        if max(moved) < _NOTHING:
            return None
        if np.any(there.present != self._here.present):
            scanned = {name: self._of_lacking(name, tried) for name, tried in scanned.items()}
        return Term(effect.name, tuple(_term_parameter(effect, m) for m in plain), scanned or None)

    def _of_lacking(self, name: str, tried: tuple[float, ...]) -> tuple[float, ...]:
        """What an appended mode takes over from the strongest mode that the model lacks; any angle is tried."""
        mode = max(self._lacking, key=lambda m: float(self.norms[m] / -self.measured.poles[m].real))
        held = {"f": self.record.frequency_hz[mode], "zeta": self.record.zeta[mode]}
        own = name.rpartition(".")[2]
        return (float(held[own]),) if own in held else _ANGLES

    @cached_property
    def _here(self) -> ResonantModes:
        return modelled_modes(self.model, self.model.complete(self._start), self.record, self.measured.poles)

    @cached_property
    def _lacking(self) -> tuple[int, ...]:
        return tuple(np.flatnonzero(~self._here.present).tolist())

    @cached_property
    def _unit(self) -> FloatArray:
        """(M, 2, S, D) the unit of Im c and Re c [1/s]: declared sd, or the mode's norm."""
        shape = (self.norms.size, 2, *self.record.R1.shape[1:])
        whole = np.broadcast_to(self.norms[:, None, None, None], shape)
        return whole if self.record.sd is None else self.record.sd

    @cached_property
    def _pole_unit(self) -> FloatArray:
        """(M,) the unit of a pole [rad/s]."""
        relative = np.sqrt(np.mean(self._unit**2, axis=(1, 2, 3))) / self.norms
        return np.asarray(-self.pole_weight * self.measured.poles.real * relative)

    def _rows(self, modes: ResonantModes) -> FloatArray:
        """(n, 1): Re and Im of every residue, then of the poles that the plant has, relative to the measured ones."""
        off = ((modes.poles - self.measured.poles) / self._pole_unit)[self._here.present]
        parts = (modes.c.imag / self._unit[:, 0], modes.c.real / self._unit[:, 1], off.real, off.imag)
        return np.concatenate([part.ravel() for part in parts])[:, None]

    @cached_property
    def _all(self) -> Model:
        """The model with every term; at their nulls they do not act."""
        larger = self.model
        for term in self.terms:
            larger = larger.with_effect(term.name)
        return larger

    def modes(self, values: Mapping[str, float]) -> ResonantModes:
        """What the model gives at ``values``; absent effects are at their null."""
        known = self._all.complete({**self._held, **values})
        return modelled_modes(self._all, known, self.record, self.measured.poles)

    @cached_property
    def _held(self) -> dict[str, float]:
        """Parameters of terms that a fit does not move."""
        scans = (item for term in self.terms for item in (term.scanned or {}).items())
        return {name: tried[0] for name, tried in scans if len(tried) == 1}

    def _predict(self, values: Mapping[str, float]) -> tuple[FloatArray, ...]:
        try:
            return (self._rows(self.modes(values)),)
        except ConfigError:
            return (self._rows(self.modes(self._possible(values))),)

    def _possible(self, values: Mapping[str, float]) -> dict[str, float]:
        """``values``, or where no device has them the last possible ones on the way from the effects' nulls.

        So a fit slides along the edge (abs(c12) <= sqrt(c11 c22)) instead of being stopped by it.
        """
        inside, outside = 0.0, 1.0
        nulls = {name: self._all.by_name[name].null for name in values if name not in self._plant_names}

        def at(share: float) -> dict[str, float]:
            return {**values, **{name: null + share * (values[name] - null) for name, null in nulls.items()}}

        if self._exists(values):
            return dict(values)
        for _ in range(_BISECTIONS):
            middle = (inside + outside) / 2.0
            inside, outside = (middle, outside) if self._exists(at(middle)) else (inside, middle)
        return at(inside)

    def _exists(self, values: Mapping[str, float]) -> bool:
        try:
            self.modes(values)
        except ConfigError:
            return False
        return True

    @cached_property
    def _plant_names(self) -> frozenset[str]:
        return frozenset(p.name for p in self.model.built.parameters)

    @cached_property
    def _problem(self) -> Regression:
        known = {name: p for name, p in self._all.parameters() if name in self._all.free}
        return Regression(
            self._predict,
            (ResidualBlock(self.record.name, self._rows(self.measured)),),
            {name: self._start[name] for name in self.model.free},
            self.terms,
            scale={name: self._size(name, p) for name, p in known.items()},
            noise_known=self.noise_known,
            limits={name: (p.low, p.high) for name, p in known.items() if p.unit != "deg"},
        )

    def _size(self, name: str, parameter: Parameter) -> float:
        """The unit of a parameter's steps; a damping ratio's is its own size, for less than none does not exist."""
        if name not in self._plant_names:
            return _SCALES * parameter.scale
        return abs(self._start[name]) if name.startswith("zeta") else max(abs(self._start[name]), 1e-2)

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        """Least squares of the model with these terms."""
        key = frozenset(terms)
        if key not in self._fits:
            try:
                self._fits[key] = self._told(self._best(terms, start))
            except (GyroscreenError, np.linalg.LinAlgError) as error:
                return FitResult(False, terms, {}, (), (), why=str(error))
        return self._fits[key]

    def _best(self, terms: tuple[str, ...], start: FitResult | None) -> FitResult:
        """A fit that ends beyond the edge may have jumped over a minimum: a second one begins inside."""
        found = self._problem.fit(terms, start)
        values = _values(found)
        possible = self._possible(values) if found.jacobian else values
        if possible == values:
            return found
        inside = {name: (v if name in self._plant_names else _INSIDE * v, np.nan) for name, v in possible.items()}
        again = self._problem.fit(terms, replace(found, parameters=inside))
        return again if again.ok and again.chi2 < found.chi2 else found

    def _told(self, fit: FitResult) -> FitResult:
        """The fit with theta as an axis, theta and split with their sd, and the error of residues at resonance."""
        if not fit.jacobian:
            return fit
        # Beyond the edge of what can be, the last possible value stands, without an sd.
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
            turn = np.zeros(len(names))
            turn[names.index("f2_hz")], turn[names.index("f1_hz")] = 1.0, -1.0
            split = parameters["f2_hz"][0] - parameters["f1_hz"][0]
            derived["split_hz"] = (split, float(np.sqrt(max(float(turn @ self.covariance(fit) @ turn), 0.0))))
        return replace(
            fit,
            parameters=parameters,
            derived=derived,
            error={"fit": float(np.sqrt(fit.chi2 / max(fit.dof, 1)))} if self.noise_known else {},
            relative_error={"fit": self.relative_error(fit)},
        )

    def covariance(self, fit: FitResult) -> FloatArray:
        """Of the free parameters (P, P)."""
        jacobian = fit.jacobian[0]
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        gram = (jacobian / scale).T @ (jacobian / scale)
        return np.asarray(np.linalg.pinv(gram, hermitian=True) / np.outer(scale, scale) * self._level(fit) ** 2)

    def _level(self, fit: FitResult) -> float:
        """Sd of a row: 1 where the noise is known, else from what is left."""
        return 1.0 if self.noise_known else float(np.sqrt(fit.chi2 / max(fit.dof, 1)))

    def relative_sd(self, fit: FitResult) -> FloatArray:
        """(M,) sd of an entry's Re or Im, in units of its mode's norm."""
        mean = np.sqrt(np.mean(self._unit**2, axis=(1, 2, 3))) / self.norms
        return np.asarray(mean * self._level(fit))

    def noise(self, fit: FitResult) -> tuple[FloatArray, FloatArray]:
        """sd of R1 and R0 / w (M, 2, S, D) [1/s] and of Re p and Im p (M,) [rad/s]."""
        return self._unit * self._level(fit), self._pole_unit * self._level(fit)

    def residuals(self, fit: FitResult) -> ComplexArray:
        """(M, S, D) measured less modelled c, each mode in units of its norm."""
        return np.asarray((self.measured.c - self.modes(_values(fit)).c) / self.norms[:, None, None])

    def relative_error(self, fit: FitResult) -> float:
        """The error of residues at resonance, as at the head of the module."""
        return float(np.sqrt(np.sum(np.abs(self.residuals(fit)) ** 2) / self.norms.size))

    def thetas(self, fit: FitResult) -> FourThetas | None:
        """The paper's four thetas with all effects of the fit taken out; ``None`` where its route does not apply."""
        if self.model.plant.kind != "gyro":
            return None
        plant = replace(self.model, effects=(), fixed={}, prior={})
        own = {p.name: _values(fit).get(p.name, self._start[p.name]) for p in plant.built.parameters}
        bare = modelled_modes(plant, plant.complete(own), self.record, self.measured.poles)
        try:
            return four_thetas(self.record, self.modes(_values(fit)).c - bare.c, self.noise(fit)[0])
        except GyroscreenError:
            return None

    def signatures(self, fit: FitResult) -> Signatures:
        """Differences at the null of every absent term."""
        return self._problem.signatures(fit)

    def probes(self, fit: FitResult) -> Signatures:
        """Every residue of a mode at will, mode by mode, and all together: an F or chi2 test of what is left."""
        count = self._rows(self.measured).size
        entries = self.measured.c.size
        mode = np.repeat(np.arange(self.norms.size), entries // self.norms.size)
        groups = {f"mode {m + 1}": np.flatnonzero(np.tile(mode, 2) == m) for m in range(self.norms.size)}
        groups["all modes"] = np.arange(2 * entries)
        candidates, columns, first = [], [], 0
        for name, rows in groups.items():
            candidates.append(
                Candidate(name, tuple(TermParameter(f"{name} {i}") for i in rows), (slice(first, first + rows.size),))
            )
            columns.append(np.eye(count)[:, rows])
            first += rows.size
        return Signatures(tuple(candidates), (np.concatenate(columns, axis=1),))

    def regions(self, fit: FitResult) -> Sequence[Region]:
        """The energy of each entry of each mode."""
        entries = self.measured.c.size
        rows = fit.blocks[0].rows[: 2 * entries].reshape(2, *self.measured.c.shape)
        energy = np.sum(rows**2, axis=0)
        shrink = fit.dof / max(fit.rows, 1)
        return [
            Region("resonance", self._labels(place), float(energy[place]), 2.0 * shrink)
            for place in np.ndindex(energy.shape)
        ]

    def spectrum(self, fit: FitResult) -> Sequence[Spectrum]:
        """None: the modes are all the frequencies there are."""
        return ()

    def _labels(self, place: tuple[int, ...]) -> dict[str, object]:
        mode, sense, drive = place
        f, zeta = float(self.record.frequency_hz[mode]), float(self.record.zeta[mode])
        return {
            "record": self.record.name,
            "mode": mode + 1,
            "channel": f"sense{sense + 1}",
            "drive": f"drive{drive + 1}",
            "band_hz": [f * (1.0 - zeta), f * (1.0 + zeta)],
        }


def _values(fit: FitResult) -> dict[str, float]:
    return {name: value for name, (value, _) in fit.parameters.items()}


def _term_parameter(effect: Effect, member: Parameter) -> TermParameter:
    return TermParameter(
        effect.full_name(member),
        member.unit,
        member.null,
        max(abs(member.high - member.null), abs(member.low - member.null)),
        1 if member.low == member.null else (-1 if member.high == member.null else 0),
    )
