"""The page of a lot: answers and residuals to HTML."""

from __future__ import annotations

from typing import Literal

from pipeline.learning.lot.loop import LotRung, first_rung
from pipeline.learning.lot.outcome import left_out
from pipeline.learning.lot.posterior import LotPosteriorAnswer
from reports.html.style import Drawing
from reports.limits_origin import LimitsOrigin
from reports.lot.figures import forecast_figure, residual_maps, spreads_figure
from reports.lot.page import LotMaps, render_lot_page

from .loop import LotAnswers


def lot_page(
    command: Literal["compare", "diagnose", "refine"],
    answers: LotAnswers,
    limits: LimitsOrigin | None = None,
    truth: str | None = None,
    posterior: LotPosteriorAnswer | None = None,
) -> str:
    """The page of a command; each one contains the comparison.  ``limits``: where they came from, where they were given."""
    rungs = answers.ladder.rungs if command == "refine" else (first_rung(answers.ready),)
    return render_lot_page(
        comparison=answers.comparison,
        diagnosis=answers.diagnosis if command == "diagnose" else None,
        refinement=answers.refinement if command == "refine" else None,
        before=maps_of(rungs[0]),
        after=maps_of(rungs[-1]) if len(rungs) > 1 else None,
        limits=limits,
        truth=truth,
        posterior=posterior,
    )


def lot_drawings(command: Literal["compare", "diagnose", "refine"], answers: LotAnswers) -> dict[str, Drawing | None]:
    """The figures of that page by name: spreads, maps-before; of refine also forecast and maps-after."""
    rungs = answers.ladder.rungs if command == "refine" else (first_rung(answers.ready),)
    before, after = maps_of(rungs[0]), maps_of(rungs[-1])
    spreads = answers.refinement.spreads if command == "refine" else answers.comparison.spreads
    return {
        "forecast": forecast_figure(answers.refinement.ladder) if command == "refine" else None,
        "spreads": spreads_figure(spreads),
        "maps-before": residual_maps(before, "maps-before"),
        "maps-after": residual_maps(after, "maps-after", before) if len(rungs) > 1 else None,
    }


def maps_of(rung: LotRung) -> LotMaps:
    """Left-out residuals of the fitted devices beside the model of a rung."""
    lot = rung.fit.lot
    z = left_out(lot, rung.fit.model, rung.fit.variances).z
    return LotMaps(lot.x_mm, lot.y_mm, lot.wafers, lot.quantities, z)
