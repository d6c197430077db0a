"""The page of a lot: what the population says, where it fails, what is missing, and the yield that it forecasts."""

from __future__ import annotations

from pipeline.learning.lot.answers import LotComparisonAnswer, LotDiagnosisAnswer, LotRefinementAnswer
from pipeline.learning.lot.gyro import MEANINGS
from pipeline.learning.lot.posterior import LotPosteriorAnswer

from ..html.rendering import environment, stylesheet
from ..limits_origin import LimitsOrigin
from ..words.limits import given_limits
from ..words.lot import ADAPTS, LEVELS, page_headline
from ..words.lot_posterior import posterior_note
from .figures import LotMaps as LotMaps
from .figures import forecast_figure, residual_maps, spreads_figure
from .posterior_figure import posterior_figure


def render_lot_page(
    comparison: LotComparisonAnswer,
    diagnosis: LotDiagnosisAnswer | None,
    refinement: LotRefinementAnswer | None,
    before: LotMaps,
    after: LotMaps | None,
    limits: LimitsOrigin | None = None,
    truth: str | None = None,
    posterior: LotPosteriorAnswer | None = None,
) -> str:
    """The page as HTML, without any request to other hosts.

    Parameters
    ----------
    before, after : residuals of the refitted population, and of the last rung of the ladder.
    limits : where the limits of the forecast came from, where they were given.
    truth : what was hidden, where that is known.
    posterior : of the most influential spreads, where it was asked for.
    """
    added = refinement.irregularities if refinement is not None else ()
    template = environment().get_template("lot.html.j2")
    return template.render(
        stylesheet=stylesheet(),
        c=comparison,
        d=diagnosis,
        r=refinement,
        headline=page_headline(comparison, diagnosis, refinement),
        added=added,
        levels=LEVELS,
        meanings=MEANINGS,
        adapts=ADAPTS,
        limits="" if limits is None else given_limits(limits),
        truth=truth,
        posterior=posterior,
        posterior_note="" if posterior is None else posterior_note(posterior),
        posterior_plot="" if posterior is None else posterior_figure(posterior),
        spreads=comparison.spreads if refinement is None else refinement.spreads,
        patterns=comparison.patterns if refinement is None else refinement.patterns,
        mixtures=comparison.mixtures if refinement is None else refinement.mixtures,
        forecast=forecast_figure(refinement.ladder) if refinement is not None else "",
        spreads_plot=spreads_figure(comparison.spreads if refinement is None else refinement.spreads),
        before=residual_maps(before, "maps-before"),
        after="" if after is None or not added else residual_maps(after, "maps-after", before),
    )
