"""What the next record would show of one effect: as the fits without and with it predict it, and how far apart they are.

    apart  = |s_1 - s_0|                                     both fits as they are
    known  = sqrt(chi2_0 - chi2_1)                           what the records so far say
    snr^2  = chi2_0 - chi2_1 + min over dp of ( |s_1 - s_0 - J_0 dp|^2 + dp' N_0 dp )

0 is the fit without the effect, 1 the fit with it; s are the new rows and all is in sigmas, as in ``criticism.separation``.  If
the effect is present at its fitted size, a fit of the old and new records without it is expected to have a chi2 larger by snr^2
than one with it.  The noise of the records lets the root of that difference scatter by about 1.

Shapes: N samples, D drives, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ...criticism.announce import announce
from ...criticism.separation import Prediction, fits_to_separate, snr
from ...errors import UsageError
from ..campaign.recorded import RecordedProblem
from .experiments import Experiment, experiments
from .predictors import changes, in_range, predictor, whitened


@dataclass(frozen=True, eq=False)
class NextRecord:
    """A record that was not measured, as two fits predict it.

    Parameters
    ----------
    effect : by which the fits differ.
    experiment : of the record, at a level that the converter can read.
    sample_rate_hz : f_s [Hz].
    drive_v : (N, D) [V].
    without_v, with_v : (N, S) predicted sense samples [V] of the fits without and with the effect.
    sigma_v : (S,) noise of a sample [V].
    apart, known, snr : see the module [sigma].
    """

    effect: str
    experiment: Experiment
    sample_rate_hz: float
    drive_v: FloatArray
    without_v: FloatArray
    with_v: FloatArray
    sigma_v: FloatArray
    apart: float
    known: float
    snr: float


def next_experiments(problem: RecordedProblem, terms: Sequence[str], effect: str) -> tuple[Experiment, ...]:
    """Experiments within what the device and the instrument have done before; ``effect`` may ask for other biases and rates.

    Raises
    ------
    UsageError : no fitted record has a drive.
    """
    if not any(np.any(record.drive_v) for record in problem.campaign.with_role("fit")):
        raise UsageError(
            "what a drive would do is not known from records without one",
            value=problem.campaign.device_id,
            allowed="a campaign with a driven record to fit",
            next_step="measure one with a drive",
        )
    fit = problem.campaign_fit(problem.fit(tuple(terms)).terms)
    return experiments(problem.campaign, fit.model, fit.values, (*terms, effect))


def next_record(problem: RecordedProblem, terms: Sequence[str], effect: str, experiment: Experiment) -> NextRecord:
    """The record of ``experiment`` by the fits with ``terms``, without and with ``effect``.

    Raises
    ------
    NegativeError : one of the fits fails.
    UsageError : the response exceeds the converter at every level that was tried.
    ConfigError : a model cannot exist at the conditions of the experiment.
    """
    without, fit = fits_to_separate(problem, terms, effect)
    announce(f"predicting the next record with {effect}")
    pair = predictor(problem, without, "without"), predictor(problem, fit, effect)
    reached = in_range(problem.campaign, pair, experiment)
    if reached is None:
        raise UsageError(
            "the response would exceed the converter", value=experiment.words, next_step="choose a lower level"
        )
    usable, record, responses = reached
    s_0, s_1 = (whitened(problem, one, record, y[:, :, None])[:, 0] for one, y in zip(pair, responses))
    # Its nuisances are those of the fit without the effect, to which the new rows would be fitted.
    simple = Prediction("without", s_0, without.chi2, pair[0].known, changes(problem, pair[0], record, exact=False))
    return NextRecord(
        effect=effect,
        experiment=usable,
        sample_rate_hz=record.sample_rate_hz,
        drive_v=record.drive_v,
        without_v=responses[0],
        with_v=responses[1],
        sigma_v=problem.noise.sigma_v,
        apart=float(np.linalg.norm(s_1 - s_0)),
        known=float(np.sqrt(max(without.chi2 - fit.chi2, 0.0))),
        snr=snr(Prediction(effect, s_1, fit.chi2, pair[1].known), simple),
    )
