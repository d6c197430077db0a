"""The records of a campaign in the time domain beside a device with given parameters; initial states and fits are kept.

Shapes: n coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...arrays import FloatArray
from ...device.effect import Effect
from ...device.model import Model
from ...errors import ConfigError
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit, campaign_fit
from ...inference.general.free_states import free_start, settled
from ...inference.general.gauss_newton import PATIENCE, GaussNewtonResult
from ...inference.general.linear_step import FitPoint
from ...inference.general.residuals import CampaignResiduals, Task, Tasks
from ..joint.part import Values


@dataclass(frozen=True, eq=False)
class TimedRecords:
    """The records beside a device.

    Parameters
    ----------
    model : the given one.
    full : with every term.
    campaign : the records.
    level : noise level.
    """

    model: Model
    full: Model
    campaign: Campaign
    level: NoiseLevel
    _states: dict[str, FloatArray] = field(default_factory=dict)
    _fits: dict[tuple[tuple[str, float], ...], CampaignFit] = field(default_factory=dict)

    @property
    def fitted(self) -> tuple[Record, ...]:
        """The records to fit."""
        return self.campaign.with_role("fit")

    @property
    def each(self) -> tuple[Record, ...]:
        """The fitted records, then those held out."""
        return (*self.fitted, *self.campaign.with_role("validate"))

    def residuals(self, model: Model) -> CampaignResiduals:
        """The residuals of a model."""
        return CampaignResiduals(model, self.campaign, self.level)

    def fit_at(self, values: Values) -> CampaignFit:
        """The records beside a device with ``values``, in the form of a fit; parameters have no sd of a fit."""
        key = tuple(sorted((name, value) for name, value in values.items() if name in self.full.by_name))
        if key not in self._fits:
            self._fits[key] = self._fit_at(values)
        return self._fits[key]

    def _fit_at(self, values: Values) -> CampaignFit:
        problem, tasks, starts, complete = self.at(values)
        count = len(self.fitted)
        fitted = Tasks(tasks.each[:count], problem.tasks(self.fitted, complete).groups)
        predicted = tuple(problem.predictions(complete, fitted, starts[:count]))
        residuals = tuple(problem.residuals_of(predicted, fitted))
        x = problem.model.to_internal(complete)
        chi2 = sum(float(np.vdot(r, r)) for r in residuals)
        at = FitPoint(x, tuple(starts[:count]), predicted, residuals, chi2)
        return campaign_fit(problem, self.campaign, self.level, fitted, GaussNewtonResult(at, np.eye(x.size), (), True))

    def at(
        self, values: Values, names: Sequence[str] = ()
    ) -> tuple[CampaignResiduals, Tasks, list[FloatArray | None], dict[str, float]]:
        """Residuals, records, initial states and parameters of a device with the effects that act or are named.

        With ``names`` only these parameters are free, so that no slope is computed in vain.
        """
        model = self.model
        for name in sorted(set(self.full.effects) - set(self.model.effects)):
            if self._acts(self.model.library[name], values, names):
                model = model.with_effect(name)
        complete = model.complete({name: values[name] for name in model.by_name if name in values})
        if not model.allowed(complete):
            raise ConfigError("a parameter is out of its range", next_step="see gyroscreen effects")
        if names:
            plant = {p.name for p in model.built.parameters}
            kept = set(names) | (plant if plant & set(names) else set())
            others = {name: value for name, value in complete.items() if name not in kept}
            model = replace(model, fixed={**others, **self.model.fixed}, prior={})
        problem = self.residuals(model)
        tasks = problem.tasks(self.each, complete)
        return problem, tasks, [self._state(problem, complete, task) for task in tasks.each], complete

    def _acts(self, effect: Effect, values: Values, names: Sequence[str]) -> bool:
        """Whether an absent effect is named, or is not at its null."""
        shape = self.full.built.shape
        own = {effect.full_name(m): m.null for m in effect.members(shape)}
        p = np.array([values.get(name, null) for name, null in own.items()])
        return bool(own.keys() & set(names)) or not effect.is_null(p, shape)

    def _state(self, problem: CampaignResiduals, complete: dict[str, float], task: Task) -> FloatArray | None:
        """The initial state of a record, from that of the values before."""
        if not task.coordinates:
            return None
        known = self._states.get(task.record.name)
        if known is None or known.size != 2 * task.coordinates:
            found = free_start(problem, complete, task)
        else:
            found = settled(problem, complete, task, known, PATIENCE)
        assert found is not None
        self._states[task.record.name] = found
        return found
