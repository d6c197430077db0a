"""Whether the records of a campaign differ from each other, and the problem and the selection that allow for it.

A hidden effect and a variation between records can both explain that a model fits some records worse than others.  The rule is:

1. Repeats decide where there are any.  A hidden effect acts on repeats alike, so if their difference correlates with the
   derivatives of the record with respect to its frequency, start and gains, the records differ.
2. Without repeats, the records are taken as equal at first.  If no set of effects explains them, but some variation is
   significant at the last model, the selection is repeated with the variation of the first model.  A single record does not
   differ from another: its start time would only take up a wrong hold of the DAC.
3. After a selection with variation, the spreads are estimated again with the selected effects.  If they shrink to zero, the
   effects alone explain the records; if they fall by much, or if an effect changes how the records are aligned (it clips them, or
   delays them), the selection is repeated.

Shapes: N samples, S senses, m deviations of a record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.special import chdtrc

from ...criticism.budget import ALPHA
from ...criticism.fit_tests import Rules
from ...criticism.problem import Problem
from ...criticism.selection import ForwardSelection, forward_selection
from ...criticism.verdict import verdict_of
from ...errors import GyroscreenError
from ...experiment.noise.level import noise_level, repeats_of
from ...inference.general.dependent_noise import campaign_dependent_noise, with_dependent_noise
from ...inference.general.deviation_columns import deviation_columns
from ...inference.general.fit import CampaignFit
from ...inference.general.residuals import CampaignResiduals
from ...inference.general.variation import RecordVariation, record_variation
from ...inference.general.varied_fit import VariedFit, clips, fit_with_variation
from .recorded import RecordedProblem

P = TypeVar("P", bound=RecordedProblem)

#: A selection is repeated if a spread falls below this share of the one that it assumed.  A hidden effect inflates the spreads;
#: while they stay too large, the records count for too little.
_SMALLER = 0.5
#: Largest number of selections with variation.
_ROUNDS = 3


def repeats_differ(problem: RecordedProblem) -> bool:
    """Whether repeats differ in their frequency, start or gains.

    delta_chi2 of the regression of (y_a - y_b) / sqrt 2 on the m derivatives of the predicted record, against chi2_m; divided
    by the level of what remains, so that noise louder than measured is no difference.  All pairs share ``ALPHA``.
    """
    pairs = repeats_of(problem.campaign)
    result = problem.fit(())
    if not pairs or not result.ok:
        return False
    fit = problem.campaign_fit(())
    residuals = CampaignResiduals(fit.model, problem.campaign, replace(problem.noise, common_v={}))
    columns = deviation_columns(fit, [a for a, _ in pairs], problem.campaign)
    for a, b in pairs:
        task = residuals.task(a, fit.values)
        c = residuals.whiten(columns[a.name], task).reshape(len(columns[a.name]), -1).T
        difference = residuals.whiten((a.sense_v - b.sense_v) / np.sqrt(2.0), task).reshape(-1)
        c = c / np.maximum(np.linalg.norm(c, axis=0), 1e-300)
        d, *_ = np.linalg.lstsq(c, difference, rcond=1e-10)
        left = difference - c @ d
        level = max(1.0, float(left @ left) / left.size)
        explained = float(difference @ difference) - float(left @ left)
        if chdtrc(c.shape[1], explained / level) < ALPHA / len(pairs):
            return True
    return False


def varied_problem(problem: P, found: VariedFit) -> P:
    """The problem with the corrected records and the noise of a fit with variation.

    Jitter follows the slope, and the corrected records are advanced.  With the jitter of the fit without variation, a start
    shift of 0.4 samples left 23 % too much energy at the resonance, and a campaign without a hidden effect was "unknown".
    """
    starts_s = {} if clips(found.fit.model) else {one.record: one.start_s for one in found.variation.deviations}
    dependent = campaign_dependent_noise(found.fit, found.campaign, starts_s) or problem.dependent
    noise = found.noise
    if dependent is not None:
        noise = with_dependent_noise(noise, dependent, found.fit, found.campaign, starts_s)
    variation, fit = (problem.measured, found.variation), found.fit
    beside = {
        name: fit.values[name]
        for term in problem.curved
        for name in fit.model.parameters_of(term)
        if name in fit.values
    }
    return problem.with_records(found.campaign, noise, variation, dependent, beside)


def prepared(problem: P) -> P:
    """The problem with jitter or gain noise where the residual shows it, and with variation where repeats differ."""
    if not problem.fit(()).ok:
        return problem
    fit = problem.campaign_fit(())
    dependent = campaign_dependent_noise(fit, problem.campaign)
    if dependent is not None:
        noise = with_dependent_noise(problem.noise, dependent, fit, problem.campaign)
        problem = problem.with_records(problem.campaign, noise, dependent=dependent)
    return _varied(problem, ()) if repeats_differ(problem) else problem


def _varied(problem: P, terms: tuple[str, ...]) -> P:
    """The problem with the variation that the records need beside the model with ``terms``; itself where they need none."""
    if not problem.fit(terms).ok:
        return problem
    found = _fit_with_variation(problem, problem.campaign_fit(terms))
    return problem if found is None or found.variation.spread.is_zero else varied_problem(problem, found)


def _fit_with_variation(
    problem: RecordedProblem, fit: CampaignFit, known: RecordVariation | None = None
) -> VariedFit | None:
    """The fit with the variation of the measured records; ``None`` where there is none, as beside a model that is wrong."""
    try:
        return fit_with_variation(fit.model, problem.measured, fit, problem.threads, known)
    except (GyroscreenError, np.linalg.LinAlgError):
        return None


def every_candidate(problem: RecordedProblem) -> Problem:
    """The problem with all of its candidates."""
    return problem


def _aligning_terms(problem: RecordedProblem, selection: ForwardSelection) -> tuple[str, ...]:
    """The terms beside which the records are aligned again: the selected ones, and one that clips them though it was refused.

    Clipped records that were advanced as if they were band-limited refuse the clipping: the held-out chi2 rose by 132 +- 40 at an
    SNR of 285.
    """
    if not selection.tests:
        return ()
    terms = selection.last.fit.terms if selection.added else ()
    for name in selection.refused:
        if "adc" in problem.model.library[name].stages and problem.fit((*terms, name)).ok:
            return (*terms, name)
    return terms


def selected(
    problem: P, rules: Rules, restricted: Callable[[P], Problem] = every_candidate
) -> tuple[P, ForwardSelection]:
    """The selection of effects, and the problem on which it was made.

    Parameters
    ----------
    problem : of :func:`prepared`.
    rules : of the selection.
    restricted : leaves out candidates.
    """
    selection = forward_selection(restricted(problem), (), rules)
    if problem.variation is None:
        decided = not selection.tests or verdict_of(selection, (), rules) != "unknown"
        # The pieces of a decay are one run; each has a state of its own already.
        records = problem.campaign.with_role("fit")
        free = not any(np.any(record.drive_v) for record in records)
        if decided or free or len(records) < 2 or repeats_of(problem.campaign):
            return problem, selection
        last = problem.campaign_fit(selection.last.fit.terms)
        if record_variation(last, problem.campaign, threads=problem.threads).spread.is_zero:
            return problem, selection
        varied = _varied(problem, ())
        if varied is problem:
            return problem, selection
        plain, problem = (problem, selection), varied
        selection = forward_selection(restricted(problem), (), rules)
    else:
        plain = None
    clipped, curved = clips(problem.model), frozenset[str]()
    for _ in range(_ROUNDS - 1):
        terms = _aligning_terms(problem, selection)
        if not terms or problem.variation is None:
            break
        fit = problem.campaign_fit(terms)
        before = problem.variation.spread
        after = record_variation(fit, problem.campaign, threads=problem.threads).spread
        if after.is_zero:
            if plain is not None:
                return plain
            noise = replace(noise_level(problem.measured), mixing=problem.noise.mixing)
            equal = problem.with_records(problem.measured, noise, dependent=problem.dependent)
            return equal, forward_selection(restricted(equal), (), rules)
        pairs = zip(before.of_deviations(1), after.of_deviations(1))
        aligned = clips(fit.model) == clipped and problem.curved & set(terms) == curved
        if aligned and not any(new < _SMALLER * old for old, new in pairs):
            break
        clipped, curved = clips(fit.model), problem.curved & set(terms)
        found = _fit_with_variation(problem, fit, problem.variation)
        if found is None:
            break
        problem = varied_problem(problem, found)
        selection = forward_selection(restricted(problem), (), rules)
    return problem, selection
