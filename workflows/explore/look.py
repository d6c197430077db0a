"""The look that all interactive pages share: colours, light and dark, layout, keyboard.

Colours of verdicts, of models and of limits are those of the reports (``reports.html.style``): distinguishable for colour-blind
readers, and of enough contrast on a light and on a dark page.  The page follows the system's choice of light or dark; figures
follow it too, because Bokeh reads colours of axes and text from the style variables ``--bk-*``.

A page is a grid of panels.  Each panel is one root of the document in a ``<section>`` with a heading; on a narrow window the grid
has one column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
from bokeh.document import Document
from bokeh.models.annotations.legends import ColorBar, Legend
from bokeh.models.ui.ui_element import UIElement
from bokeh.models.widgets.widget import Widget
from bokeh.plotting import figure

from reports.html.style import AFTER, BEFORE, COLOURS, EDGES, INK, MUTED, RULE

__all__ = ["AFTER", "BEFORE", "COLOURS", "DRAWN", "EDGES", "FEW", "HATCHES", "MARKERS", "Panel", "page", "plot"]

#: Bokeh's markers of the verdicts; they differ in shape as well as in colour.
MARKERS = {"pass": "circle", "fail": "x", "undecided": "diamond"}
#: Bokeh's patterns of bars of verdicts.
HATCHES = {"pass": " ", "fail": "/", "undecided": "."}
#: Further categories (Okabe and Ito 2008); the last two are faint on a light page (contrast 2.3).
FEW = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
#: Lines and marks on both backgrounds: contrast of 4.2 on each, the most that one grey can have on both (WCAG 2.2 asks for 3).
DRAWN = "#707d8a"
#: Widgets live in shadow trees, which inherit variables and fonts but no rules.
_WIDGETS = """
:host { font: inherit; }
.bk-input, .bk-btn { background-color: var(--page); color: var(--ink); border-color: var(--muted); }
.bk-input, .bk-btn { font: inherit; font-size: 0.9rem; }
.bk-btn:is(:hover, :focus, :active) { background-color: var(--page); color: var(--ink); }
select.bk-input { appearance: auto; background-image: none; }
.bk-input option { background-color: var(--page); color: var(--ink); }
.bk-input:focus, .bk-btn:focus, .bk-btn:focus-visible { outline: 2px solid var(--focus); outline-offset: 1px; }
.bk-input::placeholder { color: var(--muted); }
/* Without a name and in the way of the Tab key; the arrow keys do the same. */
.bk-spin-btn { display: none !important; }
label { font-size: 0.85rem; }
pre { font: 0.82rem/1.45 ui-monospace, "SF Mono", Menlo, Consolas, monospace; }
"""
_LEGENDS = ".bk-label { color: var(--ink) !important; }"
_TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True, eq=False)
class Panel:
    """A part of the page.

    Parameters
    ----------
    model : what it shows; it becomes a root of the document.
    title : its heading; also its accessible name.
    note : a sentence below the heading, or nothing.
    wide : whether it takes the whole width.
    live : whether changes of it are announced to screen readers.
    """

    model: UIElement
    title: str
    note: str = ""
    wide: bool = False
    live: bool = False


def page(document: Document, title: str, lead: str, panels: Sequence[Panel]) -> None:
    """Fill ``document``: heading, a sentence about what is shown, and the panels in order of reading.

    Parameters
    ----------
    title : heading of the page and title of the window.
    lead : one sentence about the data.
    panels : in the order of reading and of the Tab key.
    """
    document.title = title
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, loader=_loader())
    document.template = environment.get_template("page.html.j2")
    document.template_variables["lead"] = lead
    document.template_variables["panels"] = [(one.title, one.note, one.wide, one.live) for one in panels]
    document.template_variables["tokens"] = {"ink": INK, "muted": MUTED, "rule": RULE}
    for one in panels:
        document.add_root(one.model)
    for widget in document.select({"type": Widget}):
        widget.stylesheets = [*widget.stylesheets, _WIDGETS]
    for legend in (*document.select({"type": Legend}), *document.select({"type": ColorBar})):
        legend.stylesheets = [*legend.stylesheets, _LEGENDS]
        legend.background_fill_alpha = 0.0
        legend.border_line_color = None


def _loader() -> jinja2.FileSystemLoader:
    return jinja2.FileSystemLoader(_TEMPLATES)


def plot(title: str, x: str, y: str, *, height: int = 300, tools: str = "reset", **options: Any) -> figure:
    """A figure without ornament that takes the width of its panel.

    Parameters
    ----------
    title : accessible name, not drawn; the panel has the heading.
    x, y : labels of the axes with units.
    height : [px].
    tools : Bokeh's tools; wheel zoom is left out, because the wheel scrolls the page.
    options : further options of ``bokeh.plotting.figure``.
    """
    drawn = figure(
        height=height,
        sizing_mode="stretch_width",
        tools=tools,
        toolbar_location="above" if tools else None,
        x_axis_label=x,
        y_axis_label=y,
        name=title,
        **options,
    )
    if drawn.toolbar.logo is not None:
        drawn.toolbar.logo = None
    drawn.min_border_right = 12
    return drawn
