"""Style of all figures, and their conversion to inline SVG.

Colours are distinguishable for colour-blind readers and in grey print (Okabe and Ito 2008); verdicts also differ
by marker. Text remains text, so it is searchable and uses the font of the page.  Ids derive from the figure's
name and content, so the same figure gives the same bytes and two figures of a page never share an id.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import matplotlib
from matplotlib.figure import Figure

INK = "#1f2933"
MUTED = "#66727f"
RULE = "#d5dbe1"
ACCENT = "#0072b2"
TRUTH = "#cc79a7"
LIMIT = "#000000"
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


@contextmanager
def style() -> Iterator[None]:
    """Context with the settings of all figures."""
    # Start from matplotlib's defaults, so that a user's matplotlibrc cannot change a page.
    settings: Any = dict(matplotlib.rcParamsDefault) | {"backend": "agg"} | dict(_RC)
    with matplotlib.rc_context(settings):
        yield


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
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = text.replace("xlink:href=", "href=")
    text = _own_ids(text, name)
    text = re.sub(r'(\s(?:d|x|y)=")([^"]*)(")', _rounded, text)
    width, height = (round(72.0 * inches) for inches in figure.get_size_inches())
    head = f'<svg role="img" aria-label="{_attribute(description)}" viewBox="0 0 {width} {height}"'
    head = f'{head} width="{width}"'
    return re.sub(r"<svg\b[^>]*>", lambda _: f'{head} height="{height}">', text, count=1)


def _own_ids(text: str, name: str) -> str:
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))

    def renamed(match: re.Match[str]) -> str:
        return f' id="{name}-{match[1]}"' if match[1] in used else ""

    text = re.sub(r'\sid="([^"]*)"', renamed, text)
    return re.sub(r'(href="#|url\(#)', lambda match: f"{match[1]}{name}-", text)


def _rounded(match: re.Match[str]) -> str:
    return match[1] + re.sub(r"(\d\.\d\d)\d+", r"\1", match[2]) + match[3]


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
