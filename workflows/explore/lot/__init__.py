"""The interactive page of a measured lot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bokeh.document import Document

from populations.spec import PopulationSpec
from reports.limits import DEFAULT_LIMITS, Limits
from reports.words.explore_lot import lot_lead

from ...lots.loop import lot_answers
from ...lots.measured import read_measured_lot
from .bench import LotBench
from .session import LotSession


def view(
    path: Path, population: PopulationSpec | None = None, limits: Limits = DEFAULT_LIMITS
) -> Callable[[Document], None]:
    """The view of the lot at ``path``, which is read here, once; fits are made when the first session asks for them.

    Parameters
    ----------
    path : what ``gyroscreen compare LOT`` takes.
    population : that it is compared with; by default the shipped one for gyros, nested spreads for another table.
    limits : of gyros, for the yield.

    Raises
    ------
    UsageError, ConfigError, MeasurementError, IntegrityError : the lot cannot be read, or is too small for its population.
    """
    answers = lot_answers(read_measured_lot(path), population, limits)
    # A lot that is too small is refused before the page is served.
    ready = answers.ready
    bench = LotBench(answers)
    name = None if answers.spec is None else answers.spec.name

    def fill(document: Document) -> None:
        LotSession(bench, document, ready.measured.name, lot_lead(path.name, name))

    return fill
