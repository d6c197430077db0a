"""The loop: look, add the best term, refit all, test every member for removal, until nothing more is warranted.

A term is added when its score is significant among all candidates, its refit lowers chi2 as significantly, and the held-out
chi2 does not rise by more than 2 sd of the paired difference; where the noise level is not known, it has to fall by as much,
for F-tests take all that is left for white noise.  A member is removed when the fit without it is not
significantly worse.  Where no single candidate is significant but a pair is, the pair is added, one rung each.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .fit_tests import FitTests, Rules, fit_tests
from .goodness import excess
from .heldout import Paired, paired
from .pairs import best_pairs
from .problem import FitResult, Problem
from .scores import Score
from .tails import log_tail

#: A member this significant by its own estimate needs no refit without it.
SURE = 8.0
#: F statistics above this are as good as infinite.
_LARGEST = 1e100
#: Points of a grid within this share of each other are one place.
_NEAR = 0.05
_ENDED = "refitted, it ran to the end of its range, or to where the model is already"


@dataclass(frozen=True, eq=False)
class SelectionStep:
    """One term added: the fit with it, the fall of chi2, what held-out data say, and the members dropped for it.

    ``alone``: it was significant by itself, not only in a pair.
    """

    term: str
    fit: FitResult
    delta_chi2: float
    held: Paired
    dropped: tuple[str, ...] = ()
    alone: bool = True


@dataclass(frozen=True, eq=False)
class ForwardSelection:
    """How far the loop came.

    Parameters
    ----------
    looks : at the start and after every pass of the loop; the last is the end.
    steps : the terms added, in order.
    refused : term -> why it was not added although its score was significant.
    failed : the reason when the first fit failed, or those of every term that was wanted first.
    fits : every fit made, by its terms.
    """

    steps_tested: tuple[FitTests, ...]
    steps: tuple[SelectionStep, ...]
    refused: dict[str, str] = field(default_factory=dict)
    failed: str = ""
    fits: dict[frozenset[str], FitResult] = field(default_factory=dict)

    @property
    def last(self) -> FitTests:
        """The end of the climb."""
        return self.steps_tested[-1]


def forward_selection(problem: Problem, terms: tuple[str, ...] = (), rules: Rules | None = None) -> ForwardSelection:
    """Add terms until nothing more is warranted; ``terms`` are in the model from the start and may be removed too."""
    rules = rules or Rules()
    start = problem.fit(terms)
    fits = {frozenset(terms): start}
    if not start.ok:
        return ForwardSelection((), (), {}, start.why or "the baseline could not be fitted", fits)
    steps_tested, failed = [fit_tests(problem, start, rules)], ""
    steps: list[SelectionStep] = []
    refused: dict[str, str] = {}
    ended: dict[str, Score] = {}
    while len(steps) < rules.rungs:
        step, reasons, failures = _next(problem, steps_tested[-1], fits, ended, rules)
        refused.update(reasons | dict.fromkeys(failures, "its fit failed, or raised chi2"))
        if not step:
            # Later, the rungs that stand and the misfit that they leave speak for themselves.
            failed = "" if not failures or reasons or steps else f"no fit with {', '.join(failures)} succeeded"
            break
        current, dropped = _prune(problem, step[-1].fit, fits, rules)
        step = (*step[:-1], replace(step[-1], fit=current, dropped=dropped))
        seen = any(frozenset(current.terms) == frozenset(old.fit.terms) for old in steps_tested)
        steps.extend(step)
        if seen:
            break
        steps_tested.append(fit_tests(problem, current, rules))
    return ForwardSelection(tuple(steps_tested), tuple(steps), refused, failed, fits)


def _next(
    problem: Problem,
    here: FitTests,
    fits: dict[frozenset[str], FitResult],
    ended: dict[str, Score],
    rules: Rules,
) -> tuple[tuple[SelectionStep, ...], dict[str, str], tuple[str, ...]]:
    """The best step from here (one term, or a pair), reasons of refusals, and terms whose fit failed.

    ``ended`` keeps the scores of terms whose refit ran to an end: while the scan is best at the same place it would again.
    """
    reasons: dict[str, str] = {}
    failures: list[str] = []
    trials: list[SelectionStep] = []
    significant = here.significant(rules.alpha)
    top = max((score.delta_chi2 for score in significant), default=0.0)
    # A misfit that many terms nibble at is the misfit of something else.
    misfit = excess(here.regions) if here.fit.noise_known else 0.0
    near = [score for score in significant if score.delta_chi2 >= rules.near * top]
    # Without a noise level F-tests find something in whatever is left; where held-out data refuse the strongest, it is that.
    trifles = not here.fit.noise_known and bool(here.fit.held)
    for score in [*near, *(score for score in significant if score not in near)]:
        if len(trials) >= rules.contenders or (trials and (score not in near or _settled(trials, here, score, rules))):
            break
        if score.delta_chi2 < rules.promise * misfit:
            reasons[score.name] = f"it promises less than {100 * rules.promise:.0f} % of the misfit"
            continue
        if trifles and len(reasons) + len(failures) >= rules.contenders:
            reasons[score.name] = "not refitted: terms that promise more were refused"
            continue
        if score.name in ended and _same_place(score, ended[score.name]):
            reasons[score.name] = _ENDED
            continue
        fit = _fit(problem, (*here.fit.terms, score.name), here.fit, fits)
        if not fit.ok or fit.chi2 > here.fit.chi2 * (1.0 + 1e-9):
            failures.append(score.name)
            continue
        if score.name in fit.at_limit:
            reasons[score.name] = _ENDED
            ended[score.name] = score
            continue
        if not _is_nonzero(fit, score.name):
            reasons[score.name] = "refitted, its size cannot be told from none"
            continue
        fall = here.fit.chi2 - fit.chi2
        if not _worth(fall, here, score.parameters, rules.alpha):
            reasons[score.name] = "refitted, chi2 fell too little"
            continue
        if fall < rules.least * misfit:
            reasons[score.name] = f"refitted, it takes less than {100 * rules.least:.0f} % of the misfit"
            continue
        held = _held(here.fit, fit)
        if held.standing == "refused":
            reasons[score.name] = f"held-out chi2 rose by {-held.fall:.3g} +- {held.sd:.2g}"
            continue
        if _unsupported(fit, held):
            reasons[score.name] = (
                f"held-out chi2 fell by {held.fall:.3g} +- {held.sd:.2g}: no support where no noise level is known"
            )
            continue
        trials.append(SelectionStep(score.name, fit, fall, held))
    if trials:
        sizes = {score.name: score.parameters for score in here.scores}
        return (max(trials, key=lambda step: step.delta_chi2 - 2.0 * sizes[step.term]),), reasons, tuple(failures)
    if significant:
        return (), reasons, tuple(failures)
    return _pair(problem, here, fits, rules), reasons, ()


def _same_place(now: Score, before: Score) -> bool:
    """Whether the scans of a term's grid are best at the same point; a term without one is always to be refitted."""
    points = [{name: value for name, (value, sd) in score.estimate.items() if np.isnan(sd)} for score in (now, before)]
    return (
        bool(points[0])
        and points[0].keys() == points[1].keys()
        and all(abs(value - points[1][name]) <= _NEAR * abs(points[1][name]) for name, value in points[0].items())
    )


def _settled(trials: list[SelectionStep], here: FitTests, rival: Score, rules: Rules) -> bool:
    """Whether a refit that kept its promise fell so far that a rival which promises less is not worth one."""
    promised = {score.name: score.delta_chi2 for score in here.scores}
    kept = (step.delta_chi2 for step in trials if step.delta_chi2 > rules.kept * promised[step.term])
    return rival.delta_chi2 < rules.kept * max(kept, default=0.0)


def _pair(
    problem: Problem, here: FitTests, fits: dict[frozenset[str], FitResult], rules: Rules
) -> tuple[SelectionStep, ...]:
    """The most significant pair, where something is left (or nobody can tell) and no single term passes."""
    if here.fit.noise_known and here.goodness.p_value >= rules.alpha_left:
        return ()
    pairs = best_pairs(here.projected, here.signatures.candidates, here.fit.noise_known, seed=rules.seed)
    if not pairs or pairs[0].p_value >= rules.alpha:
        return ()
    first, second = sorted(pairs[0].names, key=lambda name: -_fall(here, name))
    one = _fit(problem, (*here.fit.terms, first), here.fit, fits)
    both = _fit(problem, (*here.fit.terms, first, second), one if one.ok else here.fit, fits)
    if not (one.ok and both.ok and both.chi2 <= one.chi2 <= here.fit.chi2) or {first, second} & set(both.at_limit):
        return ()
    sizes = sum(score.parameters for score in here.scores if score.name in (first, second))
    if not _worth(here.fit.chi2 - both.chi2, here, sizes, rules.alpha):
        return ()
    whole = _held(here.fit, both)
    if whole.standing == "refused" or _unsupported(both, whole):
        return ()
    return (
        SelectionStep(first, one, here.fit.chi2 - one.chi2, _held(here.fit, one), alone=False),
        SelectionStep(second, both, one.chi2 - both.chi2, _held(one, both), alone=False),
    )


def _held(before: FitResult, after: FitResult) -> Paired:
    """What the held-out data say of the step from one fit to a larger one."""
    level = 1.0 if after.noise_known else float(np.sqrt(after.chi2 / max(after.dof, 1)))
    return paired(before.held, after.held, level)


def _unsupported(fit: FitResult, held: Paired) -> bool:
    """Whether neither a noise level nor held-out data speak for a term that F-tests call significant."""
    return not fit.noise_known and bool(fit.held) and held.standing != "confirmed"


def _fall(here: FitTests, name: str) -> float:
    return next(score.delta_chi2 for score in here.scores if score.name == name)


def _worth(fall: float, here: FitTests, parameters: int, alpha: float) -> bool:
    """Whether a refit's fall is as significant as the score had to be."""
    return bool(tail_of_fall(fall, parameters, here) <= max(here.null.critical(alpha), np.log(alpha)))


def tail_of_fall(fall: float, parameters: int, here: FitTests) -> float:
    """log p of a fall of chi2 that ``parameters`` bring, at the noise level of this look (never below the nominal one)."""
    if here.fit.noise_known:
        return float(log_tail(fall / max(here.goodness.level, 1.0) ** 2, parameters))
    left = max(here.fit.dof - parameters, 1)
    return float(log_tail(min(fall * left / max(here.fit.chi2 - fall, 1e-300), _LARGEST), parameters, left))


def tail_of_rise(rise: float, parameters: int, here: FitTests) -> float:
    """log p of a rise of chi2 above this look's fit where ``parameters`` of it are taken away."""
    if here.fit.noise_known:
        return tail_of_fall(rise, parameters, here)
    left = max(here.fit.dof, 1)
    return float(log_tail(min(rise * left / max(here.fit.chi2, 1e-300), _LARGEST), parameters, left))


def _prune(
    problem: Problem, fit: FitResult, fits: dict[frozenset[str], FitResult], rules: Rules
) -> tuple[FitResult, tuple[str, ...]]:
    """Remove every member without which the fit is not significantly worse, the least significant first."""
    dropped: list[str] = []
    while len(fit.terms) > 1:
        worst: tuple[float, FitResult, str] | None = None
        for term in fit.terms[:-1] if not dropped else fit.terms:
            if wald(fit, term) > SURE**2:
                continue
            less = _fit(problem, tuple(name for name in fit.terms if name != term), fit, fits)
            if not less.ok:
                continue
            level = fit.chi2 / max(fit.dof, 1)
            level = max(1.0, level) if fit.noise_known else max(level, 1e-300)
            rise = max(less.chi2 - fit.chi2, 0.0) / level
            own = max(less.dof - fit.dof, 1)
            log_p = float(log_tail(rise, own, None if fit.noise_known else max(fit.dof, 1)))
            if log_p > np.log(rules.alpha) and (worst is None or log_p > worst[0]):
                worst = (log_p, less, term)
        if worst is None:
            break
        fit = worst[1]
        dropped.append(worst[2])
    return fit, tuple(dropped)


def _is_nonzero(fit: FitResult, term: str) -> bool:
    """Whether the size of a term is seen in its own uncertainty; a fall of chi2 without it is a jump at the null."""
    return not any(fit.shifts.get(term, ())) or wald(fit, term) > 1.0


def wald(fit: FitResult, term: str) -> float:
    """theta' C^-1 theta of a member, from the jacobian alone."""
    gram = sum((jac.T @ jac for jac in fit.jacobian), np.zeros((fit.jacobian[0].shape[1],) * 2))
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    covariance = np.linalg.pinv(gram / scale / scale[:, None], rcond=1e-14, hermitian=True)
    own = [i for i, shift in zip(fit.columns[term], fit.shifts[term]) if shift != 0.0]
    if not own:
        return 0.0
    theta = np.array([shift for shift in fit.shifts[term] if shift != 0.0]) * scale[own]
    part = covariance[np.ix_(own, own)]
    level = max(1.0, fit.chi2 / max(fit.dof, 1)) if fit.noise_known else fit.chi2 / max(fit.dof, 1)
    return float(theta @ np.linalg.pinv(part, hermitian=True) @ theta) / max(level, 1e-300)


def _fit(
    problem: Problem, terms: tuple[str, ...], start: FitResult, fits: dict[frozenset[str], FitResult]
) -> FitResult:
    key = frozenset(terms)
    if key not in fits:
        fits[key] = problem.fit(terms, start)
    return fits[key]
