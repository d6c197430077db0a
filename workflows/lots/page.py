"""The page of a lot: answers and residuals to HTML."""

from __future__ import annotations

from typing import Literal

from pipeline.learning.lot.loop import LotRung, first_rung
from pipeline.learning.lot.outcome import left_out
from reports.lot.page import LotMaps, render_lot_page

from .loop import LotAnswers


def lot_page(command: Literal["compare", "diagnose", "refine"], answers: LotAnswers, truth: str | None = None) -> str:
    """The page of a command; each one contains the comparison."""
    rungs = answers.ladder.rungs if command == "refine" else (first_rung(answers.ready),)
    return render_lot_page(
        comparison=answers.comparison,
        diagnosis=answers.diagnosis if command == "diagnose" else None,
        refinement=answers.refinement if command == "refine" else None,
        before=maps_of(rungs[0]),
        after=maps_of(rungs[-1]) if len(rungs) > 1 else None,
        truth=truth,
    )


def maps_of(rung: LotRung) -> LotMaps:
    """Left-out residuals of the fitted devices beside the model of a rung."""
    lot = rung.fit.lot
    z = left_out(lot, rung.fit.model, rung.fit.variances).z
    return LotMaps(lot.x_mm, lot.y_mm, lot.wafers, lot.quantities, z)
