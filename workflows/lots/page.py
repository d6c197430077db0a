"""The page of a lot: answers and residuals to HTML."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pipeline.learning.lot.null import projected
from pipeline.learning.lot.outcome import left_out
from reports.lot.page import LotMaps, render_lot_page

from .loop import LotAnswers


def lot_page(command: Literal["compare", "diagnose", "refine"], answers: LotAnswers, truth: str | None = None) -> str:
    """The page of a command; each one contains the comparison."""
    ready = answers.ready
    refinement = answers.refinement if command == "refine" else None
    if refinement is not None:
        rung = answers.ladder.rungs[-1]
        maps = _maps(rung.ready.whole.subset(~rung.ready.whole.is_held), rung.fit.model, rung.fit.variances)
        before = answers.ladder.rungs[0]
    else:
        from pipeline.learning.lot.loop import first_rung

        before = first_rung(ready)
        maps = None
    first = _maps(before.fit.lot, before.fit.model, before.fit.variances)
    return render_lot_page(
        comparison=answers.comparison,
        diagnosis=answers.diagnosis if command != "compare" else None,
        refinement=refinement,
        before=first,
        after=maps,
        truth=truth,
    )


def _maps(lot, model, variances) -> LotMaps:  # type: ignore[no-untyped-def]
    z = left_out(lot, model, variances).z
    return LotMaps(lot.x_mm, lot.y_mm, lot.wafers, lot.quantities, z)


_ = (np, projected)
