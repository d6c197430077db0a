"""Variation between records, estimated from the fit of a campaign.

    y_k = f(x) + C_k d_k + e,     d_k ~ N(0, D),     D = diag(s_phi^2, s_tau^2, s_g^2 .., s_b^2 ..)
    C_k = d f_k / d (phi, tau, g_1 .., b_1 ..)

The spreads s maximise the restricted likelihood of the fit records (``variance_components``).

Shapes: K fit records, N samples, S senses, P parameters, m deviations of a record; whitened columns in sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...experiment.forward.drive_groups import highest_drive_energy
from ...experiment.forward.sensitivity import STRONG
from ...experiment.record import Campaign
from ...experiment.variation import KINDS, Deviations, RecordSpread, kind_of_deviation
from .deviation_columns import deviation_columns
from .fit import CampaignFit
from .linear_step import with_starts
from .residuals import CampaignResiduals, Tasks
from .variance_components import Grams, grams_of, solved, spread_of, with_residuals

#: Largest spreads: frequency [1], start [samples], gain [1], ramp [V].  Three times the variation of a stable bench (10 ppm is
#: 1 K at a typical temperature coefficient); larger differences are another device or set-up, which must remain a misfit.
_LARGEST = (3e-5, 3.0, 3e-3, 0.1)


@dataclass(frozen=True, eq=False)
class RecordVariation:
    """The spreads, and the deviations of every driven record, fitted and held out."""

    spread: RecordSpread
    deviations: tuple[Deviations, ...]

    def of(self, record: str) -> Deviations | None:
        """The deviations of a record by name."""
        return next((one for one in self.deviations if one.record == record), None)


def record_variation(fit: CampaignFit, campaign: Campaign, most: int = len(KINDS), threads: int = 1) -> RecordVariation:
    """The spreads, from the fit records, and the deviations of all driven records at a fit.

    Parameters
    ----------
    fit : of the campaign.
    campaign : its records; deviations of first order are still in them.
    most : number of kinds of variation that may be found.
    threads : how many records are integrated at once.
    """
    driven = (*campaign.with_role("fit"), *campaign.with_role("validate"))
    linear = linearized(fit, campaign, deviation_columns(fit, driven, campaign), threads)
    g, residuals = with_records(linear, campaign)
    return estimated(linear, g, residuals, spread_at(linear, g, most))[0]


@dataclass(frozen=True, eq=False)
class Linearized:
    """A campaign linearized at a fit.

    Parameters
    ----------
    fit : the fit.
    c_v : deviation columns (m, N, S) [V per unit] by record.
    residuals : the problem without common signals.
    tasks : the driven records, those of the fit first.
    columns, jacobians : C (n, m) of every driven record and J (n, P) with the initial states of the fit records, in sigmas.
    products : of the columns of the fit records; those with the residual are not used.
    """

    fit: CampaignFit
    c_v: Mapping[str, FloatArray]
    residuals: CampaignResiduals
    tasks: Tasks
    columns: Sequence[FloatArray]
    jacobians: Sequence[FloatArray]
    products: Grams


def linearized(fit: CampaignFit, campaign: Campaign, c_v: Mapping[str, FloatArray], threads: int) -> Linearized:
    """The campaign linearized at a fit, with the deviation columns ``c_v`` (m, N, S) [V per unit] of each driven record."""
    problem = CampaignResiduals(fit.model, campaign, replace(fit.noise, common_v={}), threads)
    fitted = campaign.with_role("fit")
    driven = (*fitted, *campaign.with_role("validate"))
    known = {record.name: record for record in fit.records}
    tasks = problem.tasks(driven, fit.values)
    starts = [known[r.name].start for r in driven]
    columns = [problem.whiten(c_v[t.record.name], t).reshape(len(c_v[t.record.name]), -1).T for t in tasks.each]
    reference = highest_drive_energy([r.drive_v for r in fitted])
    exact = problem.strength(fit.values, tasks.each[reference], starts[reference]) > STRONG
    steps = problem.steps(fit.values, tasks.each[reference], starts[reference])
    jacobians = problem.columns(fit.values, tasks, starts, exact, steps)
    free = [None if s is None else problem.start_columns(fit.values, t, s, exact) for t, s in zip(tasks.each, starts)]
    count = len(fitted)
    wide = with_starts(list(zip(jacobians[:count], free[:count])))
    none = [np.zeros(j.shape[0]) for j in wide]
    products = grams_of(columns[:count], wide, none)
    return Linearized(fit, c_v, problem, tasks, columns, (*wide, *jacobians[count:]), products)


def with_records(linear: Linearized, campaign: Campaign) -> tuple[Grams, list[FloatArray]]:
    """The products and the residuals (n,) of every driven record, in sigmas, for the records of ``campaign``."""
    known = {record.name: record.predicted_v for record in linear.fit.records}
    measured = {record.name: record.sense_v for record in campaign.records}
    names = [(t, t.record.name) for t in linear.tasks.each]
    residuals = [linear.residuals.whiten(measured[name] - known[name], t).reshape(-1) for t, name in names]
    count = len(linear.products.cc)
    own = (linear.columns[:count], linear.jacobians[:count], residuals[:count])
    return with_residuals(linear.products, *own), residuals


def spread_at(linear: Linearized, g: Grams, most: int) -> RecordSpread:
    """The spreads of largest restricted likelihood for the products ``g``, of at most ``most`` kinds."""
    first = linear.tasks.each[0].record
    largest = np.array(_LARGEST) * (1.0, 1.0 / first.sample_rate_hz, 1.0, 1.0)
    return spread_of(g, kind_of_deviation(first.sense_v.shape[1]), largest, most)


def estimated(
    linear: Linearized,
    g: Grams,
    residuals: Sequence[FloatArray],
    spread: RecordSpread,
    held: bool = False,
) -> tuple[RecordVariation, FloatArray]:
    """The deviations of the records at given spreads, and the step (P,) of the parameters that goes with them; 0 if ``held``."""
    tasks, count = linear.tasks.each, len(linear.products.cc)
    sd = spread.of_deviations(tasks[0].record.sense_v.shape[1])
    best = solved(g.without_parameters() if held else g, sd)
    out = [
        Deviations(t.record.name, d, np.sqrt(np.diagonal(v)))
        for t, d, v in zip(tasks, best.deviations, best.covariances)
    ]
    width = len(linear.fit.names)
    dx = np.zeros(width) if held else best.dx[:width]
    for t, c, j, r in zip(tasks[count:], linear.columns[count:], linear.jacobians[count:], residuals[count:]):
        # The parameters come from the fit records only.
        alone = solved(grams_of([c], [np.zeros((r.size, 1))], [r - j @ dx]), sd)
        out.append(Deviations(t.record.name, alone.deviations[0], np.sqrt(np.diagonal(alone.covariances[0]))))
    return RecordVariation(spread, tuple(out)), dx
