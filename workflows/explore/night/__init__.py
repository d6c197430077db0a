"""The interactive page of a run: yield, limits that move, wafer map, two quantities, one device."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bokeh.document import Document
from bokeh.models.layouts import Column, Row
from bokeh.models.ui.ui_element import UIElement

from reports.words.explore import FIGURES, NOTES

from ..look import Panel, page
from .markup import lead
from .session import Session
from .stored import load


def view(path: Path) -> Callable[[Document], None]:
    """The view of the run in the folder ``path``; its tables are read here, once.

    Raises
    ------
    UsageError : the run has no devices.
    IntegrityError : a file is not what was committed.
    """
    night = load(path)
    # One thread: judgements follow each other, and the newest limits win.
    worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="judge")

    def fill(document: Document) -> None:
        session = Session(night, document, worker)
        page(document, f"Night {night.run_id}", lead(night), _panels(session))

    return fill


def _panels(session: Session) -> list[Panel]:
    s = session
    parts: dict[str, list[UIElement]] = {
        "yield": [s.total],
        "limits": [s.quantity, s.distribution.figure, _row(s.low, s.high, s.reset), s.remark],
        "wafer": [_row(s.wafer, s.colour), s.map.figure, s.drawn],
        "scatter": [_row(s.x, s.y), s.pair],
        "device": [_row(s.name, s.channel), s.details, s.left, s.curves.spectrum, s.curves.residual],
        "file": [s.file],
    }
    wide, live = ("yield", "file"), ("yield",)
    return [
        Panel(
            items[0] if len(items) == 1 else Column(*items, sizing_mode="stretch_width", name=name),
            FIGURES[name],
            NOTES[name],
            name in wide,
            name in live,
        )
        for name, items in parts.items()
    ]


def _row(*items: UIElement) -> Row:
    return Row(*items, sizing_mode="stretch_width")
