"""What compare and refine say about the posterior of the spreads of a lot."""

from __future__ import annotations

from pipeline.learning.lot.posterior import AGREES, ESS_MIN, RHAT_MAX, LotPosteriorAnswer

from .numbers import number


def posterior_lines(answer: LotPosteriorAnswer) -> list[str]:
    """Each spread with its posterior beside its REML interval, then the convergence."""
    return [
        "posterior of the most influential spreads (ratio to the file, median, 90 % interval; REML beside it):",
        *(
            f"  {name}: {number(one.median, 3)} ({number(one.low, 3)} to {number(one.high, 3)}); REML {number(one.reml, 3)}"
            f" ({number(one.reml_low, 3)} to {number(one.reml_high, 3)})"
            for name, one in answer.spreads.items()
        ),
        posterior_note(answer),
    ]


def posterior_note(answer: LotPosteriorAnswer) -> str:
    """Prior, what the posterior is marginal over, and convergence."""
    state = (
        ""
        if answer.converged
        else f" Not converged: R-hat at most {RHAT_MAX:g}, ESS at least {ESS_MIN:g} an error of at most {AGREES:g} are needed."
    )
    others = f", patterns and {len(answer.marginal)} other spreads" if answer.marginal else " and patterns"
    return (
        f"The prior is flat in the sd up to ten times the file's spread; the posterior is marginal over means{others}. "
        f"{answer.draws} draws of emcee, R-hat {number(answer.rhat, 4)}, ESS {number(answer.ess, 3)}, "
        f"acceptance {number(answer.acceptance, 2)}; the log likelihood of the chains is right to "
        f"{number(answer.surface_error, 2)}.{state}"
    )
