"""Style and layout of all figures, and their conversion to inline SVG.

Colours are distinguishable for colour-blind readers and in grey print (Okabe and Ito 2008); verdicts also differ
by marker. Text remains text, so it is searchable and uses the font of the page.  Ids derive from the figure's
name and content, so the same figure gives the same bytes and two figures of a page never share an id.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

INK = "#1f2933"
MUTED = "#66727f"
RULE = "#d5dbe1"
ACCENT = "#0072b2"
TRUTH = "#cc79a7"
LIMIT = "#000000"
# What the first model leaves, and what the last one leaves.
BEFORE, AFTER = "#d55e00", "#0072b2"
COLOURS: Mapping[str, str] = MappingProxyType({"pass": "#0072b2", "fail": "#d55e00", "undecided": "#f0c93b"})
EDGES: Mapping[str, str] = MappingProxyType({"pass": "#0072b2", "fail": "#d55e00", "undecided": "#7a5c00"})
MARKERS: Mapping[str, str] = MappingProxyType({"pass": "o", "fail": "X", "undecided": "D"})
HATCHES: Mapping[str, str] = MappingProxyType({"pass": "", "fail": "////", "undecided": ".."})
# Maximum number of points in a scatter plot: more would only enlarge the page.
POINTS = 700
# Width of a figure [inch at 72 points]: that of the page.
WIDTH = 10.25

_RC: Mapping[str, Any] = MappingProxyType(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "gyroscreen",
        "font.family": "sans-serif",
        "font.size": 11.0,
        "axes.titlesize": 11.0,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 10.5,
        "axes.labelcolor": INK,
        "axes.edgecolor": MUTED,
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.unicode_minus": True,
        "text.color": INK,
        "xtick.color": MUTED,
        "ytick.color": MUTED,
        "xtick.labelcolor": INK,
        "ytick.labelcolor": INK,
        "xtick.labelsize": 10.0,
        "ytick.labelsize": 10.0,
        "legend.frameon": False,
        "legend.fontsize": 10.0,
        "hatch.linewidth": 0.45,
        "figure.dpi": 72.0,
        "path.simplify": True,
    }
)

_COORDINATES = re.compile(r'\s[dxy]="[^"]*"')
#: Looking behind needs no replacement text: Python puts each of them, 50,000 in a page, together itself.
_MORE_DECIMALS = re.compile(r"(?<=\d\.\d\d)\d+")

Share = bool | Literal["none", "all", "row", "col"]


@contextmanager
def style() -> Iterator[None]:
    """Context with the settings of all figures."""
    # Start from matplotlib's defaults, so that a user's matplotlibrc cannot change a page.
    settings: Any = dict(matplotlib.rcParamsDefault) | {"backend": "agg"} | dict(_RC)
    with matplotlib.rc_context(settings):
        yield


def literal(text: str) -> str:
    """``text`` with its dollar signs escaped, which would otherwise start a formula."""
    return text.replace("$", r"\$")


def log_ticks(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis: 1, 2, 5 of each decade; only decades over a long range, round steps within one."""
    low, high = axis.get_view_interval()
    ratio = high / max(low, 1e-300)
    if ratio < 4.0:
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if ratio < 300.0 else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    left: float = 0.75,
    right: float = 0.1,
    bottom: float = 0.95,
    top: float = 0.32,
    gap: float = 0.28,
    between: float = 0.3,
    sharex: Share = False,
    sharey: Share = False,
    height_ratios: tuple[float, ...] | None = None,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of the page's width and its axes, rows of columns; call it within ``style()``.

    The margins are given: constrained layout would draw every figure twice to find them.

    Parameters
    ----------
    height : of a row [inch]; the figure grows with the rows.
    left, right, bottom, top : margins [inch].
    gap, between : between columns and between rows [inch].
    sharex, sharey, height_ratios : as of ``Figure.subplots``.
    """
    whole = rows * height + (rows - 1) * between + bottom + top
    wide = (WIDTH - left - right - (columns - 1) * gap) / columns
    figure = Figure(figsize=(WIDTH, whole))
    ratios: dict[str, Any] = {} if height_ratios is None else {"height_ratios": height_ratios}
    grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey, **ratios)
    figure.subplots_adjust(
        left=left / WIDTH,
        right=1.0 - right / WIDTH,
        bottom=bottom / whole,
        top=1.0 - top / whole,
        wspace=gap / wide,
        hspace=between / height,
    )
    return figure, [list(row) for row in grid]


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure that was drawn within :func:`style`, for a page or for a notebook.

    Templates show it as inline SVG; ``figure`` belongs to no pyplot state.

    Parameters
    ----------
    figure : the figure.
    name : unique in the page; letters, digits and hyphens.
    description : what the figure shows, as alternative text; plain text.
    """

    figure: Figure
    name: str
    description: str

    def __html__(self) -> str:
        """The figure as markup of a page."""
        with style(), warnings.catch_warnings():
            # Text stays text in an SVG, so a letter that matplotlib's own font lacks does no harm.
            warnings.filterwarnings("ignore", message="Glyph")
            return to_svg(self.figure, self.name, self.description)


def to_svg(figure: Figure, name: str, description: str) -> str:
    """The figure as an inline ``<svg>`` element: no prolog, metadata or addresses, and unique ids.

    Parameters
    ----------
    figure : drawn within :func:`style`.
    name : unique in the page; letters, digits and hyphens.
    description : what the figure shows, as alternative text; plain text.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    text = text.replace("xlink:href=", "href=")
    text = _own_ids(text, name)
    text = _COORDINATES.sub(_rounded, text)
    width, height = (round(72.0 * inches) for inches in figure.get_size_inches())
    head = f'<svg role="img" aria-label="{_attribute(description)}" viewBox="0 0 {width} {height}"'
    head = f'{head} width="{width}"'
    # The addresses of the name spaces go with the old head.
    return re.sub(r"<svg\b[^>]*>", lambda _: f'{head} height="{height}">', text, count=1)


def _own_ids(text: str, name: str) -> str:
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))

    def renamed(match: re.Match[str]) -> str:
        return f' id="{name}-{match[1]}"' if match[1] in used else ""

    text = re.sub(r'\sid="([^"]*)"', renamed, text)
    return text.replace('href="#', f'href="#{name}-').replace("url(#", f"url(#{name}-")


def _rounded(match: re.Match[str]) -> str:
    return _MORE_DECIMALS.sub("", match[0])


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
