"""The interactive page of a run: wafer map, distributions, limits that can be moved, devices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bokeh.document import Document
from bokeh.models import Div

from ..look import Panel, page, plot


def view(path: Path) -> Callable[[Document], None]:
    """The view of the run in the folder ``path``."""

    def fill(document: Document) -> None:
        drawn = plot("test", "x, Hz", "devices")
        drawn.scatter([1, 2, 3], [1, 4, 9])
        page(document, f"Night {path.name}", "A test.", [Panel(drawn, "Map"), Panel(Div(text="hello"), "Words")])

    return fill
