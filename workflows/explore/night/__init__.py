"""The interactive page of a run: yield, limits that move, wafer map, two quantities, one device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bokeh.document import Document
from bokeh.models.layouts import Row
from bokeh.models.ui.ui_element import UIElement
from bokeh.models.widgets.markups import Div, PreText

from reports.words.explore import FIGURES, NOTES

from ..look import Panel, page
from ..parts import stacked
from ..process import StoppableProcess
from ..thread import DaemonThread
from .device_panel import DevicePanel
from .file import toml_of
from .judged import preview
from .limits_panel import LimitsPanel
from .markup import lead, yield_html
from .points_panels import PointsPanels
from .state import NightState
from .stored import load


def view(path: Path) -> Callable[[Document], None]:
    """The view of the run in the folder ``path``; its tables are read here, once.

    Raises
    ------
    UsageError : the run has no devices.
    IntegrityError : a file is not what was committed.
    """
    night = load(path)
    if night.has_draws and night.known:
        # The first preview compiles its kernels or loads them, which a movement would wait for.
        preview(night, night.limits, night.limits.quantities[0], None)
    worker, judge = DaemonThread("devices"), StoppableProcess("judge", "workflows.explore.night.judged")

    def fill(document: Document) -> None:
        judge.start()
        page(document, f"Night {night.run_id}", lead(night), panels(NightState(night, document, worker, judge)))

    return fill


def panels(state: NightState) -> list[Panel]:
    """The panels of a page, in the order of reading."""
    total, file = _yield(state), _file(state)
    limits, points, device = LimitsPanel(state), PointsPanels(state), DevicePanel(state)
    parts: dict[str, list[UIElement]] = {
        "yield": [total],
        "limits": [
            limits.quantity, limits.distribution.figure, _row(limits.low, limits.high, limits.reset),
            limits.reading, points.remark,
        ],
        "wafer": [_row(points.wafer, points.colour), points.map.figure, points.drawn],
        "scatter": [_row(points.x, points.y), points.pair],
        "device": [
            _row(device.name, device.channel), device.details, device.left, device.curves.spectrum,
            device.curves.residual,
        ],
        "file": [file],
    }  # fmt: skip
    wide, live = ("yield", "file"), ("yield",)
    return [
        Panel(_column(*items), FIGURES[name], NOTES[name], name in wide, name in live) for name, items in parts.items()
    ]


def _yield(state: NightState) -> Div:
    """The yield as text."""
    shown = Div(sizing_mode="stretch_width", name="yield")

    def show() -> None:
        shown.text = yield_html(state.night, state.judged, state.message)

    state.follow("verdicts", show)
    state.follow("message", show)
    show()
    return shown


def _file(state: NightState) -> PreText:
    """The limits as a file."""
    shown = PreText(name="file", styles={"overflow": "auto"}, sizing_mode="stretch_width")

    def show() -> None:
        shown.text = toml_of(state.limits)

    state.follow("verdicts", show)
    show()
    return shown


def _row(*items: UIElement) -> Row:
    return Row(*items, sizing_mode="stretch_width", styles={"min-width": "0"})


def _column(*items: UIElement) -> UIElement:
    return items[0] if len(items) == 1 else stacked(*items)
