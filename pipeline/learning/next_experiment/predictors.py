"""A fit as a predictor of records that are not yet measured: its response, and how that changes with its parameters.

Shapes: N samples, D drives, S senses, F free parameters of the model, P columns of the old rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import FitResult
from ...criticism.separation import known_of
from ...experiment.forward.record import forward, jacobian
from ...experiment.forward.sensitivity import tuned_steps
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit
from ...inference.general.gauss_newton import ITERATIONS
from ...inference.general.residuals import nuisance_columns
from ..campaign.recorded import RecordedProblem
from .experiments import Experiment, within


@dataclass(frozen=True, eq=False)
class Predictor:
    """A fit that predicts new records.

    Parameters
    ----------
    name : by which it is told from others.
    fitted, chi2 : the fit, and its chi2 on the old records.
    known : (P, P) square root of the information of the old rows, those of other domains included.
    places : for each of the F free parameters of the model its column of ``known``; -1 where it was not fitted.
    jacobian : (F, F) d values / d smooth coordinates.
    steps : (F,) of the finite differences.
    """

    name: str
    fitted: CampaignFit
    chi2: float
    known: FloatArray
    places: IntArray
    jacobian: FloatArray
    steps: FloatArray


def predictor(problem: RecordedProblem, fit: FitResult, name: str) -> Predictor:
    """``fit``, which ``problem`` made and which is ok, as a predictor of that name."""
    fitted, campaign = problem.campaign_fit(fit.terms), problem.campaign
    plain = replace(campaign.with_role("fit")[0], at_rest=True)
    steps = tuned_steps(fitted.model, fitted.values, plain, campaign.instrument, angular_gain=campaign.angular_gain)
    fitted_names = problem.fitted_names(fit)
    places = np.array([fitted_names.index(n) if n in fitted_names else -1 for n in fitted.model.free], dtype=np.int64)
    return Predictor(name, fitted, fit.chi2, known_of(fit), places, fitted.model.values_jacobian(fitted.x), steps)


def response(campaign: Campaign, one: Predictor, record: Record) -> FloatArray:
    """(N, S) predicted sense samples [V]."""
    model, values = one.fitted.model, one.fitted.values
    return forward(model, values, record, campaign.instrument, angular_gain=campaign.angular_gain)


def in_range(
    campaign: Campaign, every: Sequence[Predictor], experiment: Experiment
) -> tuple[Experiment, Record, list[FloatArray]] | None:
    """The experiment at a level that the converter can read, its record, and the responses (N, S) [V].

    ``None`` where no level was found.

    Raises
    ------
    ConfigError : a model cannot exist at the conditions of the experiment.
    """
    for _ in range(ITERATIONS):
        record = experiment.record(campaign)
        responses = [response(campaign, one, record) for one in every]
        lower = within(experiment, max(float(np.max(np.abs(y))) for y in responses), campaign.instrument.adc)
        if lower is experiment:
            return experiment, record, responses
        experiment = lower
    return None


def changes(problem: RecordedProblem, one: Predictor, record: Record, exact: bool) -> FloatArray:
    """(N S, P) change of a new record with the parameters of a fit, in sigmas."""
    fitted, campaign = one.fitted, problem.campaign
    columns = jacobian(
        fitted.model,
        fitted.values,
        record,
        campaign.instrument,
        angular_gain=campaign.angular_gain,
        exact=exact,
        steps=one.steps,
    )
    white, fitted_too = whitened(problem, one, record, columns), one.places >= 0
    # The other columns of the old rows are initial states of single records, and parameters of other instruments.
    wide = np.zeros((white.shape[0], one.known.shape[1]))
    wide[:, one.places[fitted_too]] = np.linalg.solve(one.jacobian.T, white.T).T[:, fitted_too]
    return wide


def whitened(problem: RecordedProblem, one: Predictor, record: Record, y: FloatArray) -> FloatArray:
    """Volts (N, S, k) as rows (N S, k) in sigmas, with the nuisances of every channel projected out."""
    n = nuisance_columns(one.fitted.model, one.fitted.values, record, problem.campaign.instrument)
    white = (y / problem.noise.sigma_v[:, None]).reshape(y.shape[0], -1)
    return np.asarray((white - n @ (n.T @ white)).reshape(-1, y.shape[2]))
