"""Start values of the parameters of effects, where their null value is no start.

A parameter that does not exist at the null of its effect (the frequency of a mode, a clip level) is scanned on a grid, and the
shape of a disturbance (mains frequency, number of harmonics) is the one that the residuals without it support best.  Records that
do not start at rest begin in the state that explains them best without the effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from ...device.model import Model
from ...experiment.forward.drive_groups import highest_drive_energy
from ...experiment.forward.sensitivity import STRONG
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign
from .free_disturbances import best_shape
from .free_states import free_start
from .linear_step import with_starts
from .residuals import CampaignResiduals
from .scan import scan


def scanned_effects(model: Model, known: Mapping[str, float]) -> tuple[str, ...]:
    """Effects of ``model`` with parameters on a grid, of which no value is ``known``."""
    shape, found = model.built.shape, []
    for effect in model.ordered_effects():
        # The shape of a disturbance is chosen otherwise; parameters that are not fitted (which channel) are scanned, too.
        members = [m for m in effect.members(shape) if m.fitted or effect.disturbance is None]
        if any(m.grid for m in members) and not any(effect.full_name(m) in known for m in members):
            found.append(effect.name)
    return tuple(found)


def with_effect_starts(
    model: Model,
    campaign: Campaign,
    noise: NoiseLevel,
    start: Mapping[str, float],
    likely: Mapping[str, tuple[float, ...]],
    threads: int,
) -> tuple[Model, dict[str, float]]:
    """The model with its disturbances fixed in shape, and ``start`` with the start values that its effects need.

    Parameters
    ----------
    model, campaign, noise : what will be fitted.
    start : values of all plant parameters, and of the effects' parameters that are known.
    likely : parameter -> values that a scan tries instead of its grid.
    threads : how many records are integrated at once.
    """
    values = dict(start)
    for name in scanned_effects(model, values):
        values |= _scanned(model, name, campaign, noise, values, likely, threads)
    for effect in model.ordered_effects():
        shape = {effect.full_name(m) for m in effect.members(model.built.shape) if not m.fitted}
        if effect.disturbance is not None and not shape <= values.keys():
            values = _shaped(model, effect.name, campaign, noise, values) | values
        model = replace(model, fixed={**model.fixed, **{name: values[name] for name in shape if name in values}})
    return model, values


def _scanned(
    model: Model,
    effect: str,
    campaign: Campaign,
    noise: NoiseLevel,
    start: Mapping[str, float],
    likely: Mapping[str, tuple[float, ...]],
    threads: int,
) -> dict[str, float]:
    """Start values of an effect with scanned parameters, from the model without it at its start values."""
    smaller = model.without_effect(effect)
    problem = CampaignResiduals(smaller, campaign, noise, threads)
    values = smaller.complete({name: value for name, value in start.items() if name in smaller.by_name})
    tasks = problem.tasks(campaign.with_role("fit"), values)
    starts, shape = [free_start(problem, values, task) for task in tasks.each], model.built.shape
    reference = highest_drive_energy([task.record.drive_v for task in tasks.each])
    strongest = tasks.each[reference], starts[reference]
    # With linear columns of a strongly hardening decay the size of a hysteresis was 50 times too small, and its fit got stuck.
    exact = problem.strength(values, *strongest) > STRONG
    columns = problem.columns(values, tasks, starts, exact, problem.steps(values, *strongest))
    free = [None if s is None else problem.start_columns(values, t, s, exact) for t, s in zip(tasks.each, starts)]
    return scan(
        smaller,
        effect,
        values,
        tasks,
        campaign.instrument,
        starts,
        problem.residuals(values, tasks, starts),
        with_starts(list(zip(columns, free))),
        [partial(problem.whiten, task=task) for task in tasks.each],
        {m.name: likely.get(model.effect(effect).full_name(m), ()) for m in model.effect(effect).members(shape)},
    )


def _shaped(
    model: Model, effect: str, campaign: Campaign, noise: NoiseLevel, start: Mapping[str, float]
) -> dict[str, float]:
    """The shape of a disturbance that the residuals without it support best."""
    smaller = model.without_effect(effect)
    problem = CampaignResiduals(smaller, campaign, noise)
    values = smaller.complete({name: value for name, value in start.items() if name in smaller.by_name})
    tasks = problem.tasks(campaign.with_role("fit"), values)
    residuals = problem.residuals(values, tasks, [free_start(problem, values, task) for task in tasks.each])
    rates = [task.record.sample_rate_hz for task in tasks.each]
    return best_shape(model.effect(effect), model.built.shape, residuals, rates)
