"""The page of the paper: its figures redrawn, its printed numbers recomputed.

PaperContent --figures, template--> HTML, one self-contained file
"""

from __future__ import annotations

import math

from markupsafe import Markup

from ..html.rendering import environment, number, stylesheet
from ..html.style import Drawing
from ..words.quantities import SUPERSCRIPT
from .content import PaperContent, PrintedNumber
from .figures import axes as paper_axes
from .figures import identification as paper_identification


def paper_figures(content: PaperContent) -> dict[str, Drawing]:
    """All figures of the page by name."""
    return {
        "figure-4": paper_identification.records(content.records),
        "figure-5": paper_identification.broadband(content.responses),
        "figure-6": paper_identification.zoomed(content.responses),
        "hankel": paper_identification.hankel(content.hankel),
        "thetas": paper_axes.thetas(content.thetas_deg),
        "orders": paper_axes.orders(content.orders),
        "steps": paper_axes.steps(content.steps),
    }


def render_paper(content: PaperContent) -> str:
    """The page as HTML text; the same content gives the same page."""
    env = environment()
    env.filters.update(printed=printed, ours=ours, deviation=deviation)
    page = env.get_template("paper.html.j2")
    return page.render(c=content, figures=paper_figures(content), stylesheet=stylesheet(), style_here=Markup(_STYLE))


_STYLE = """
body { max-width: 900px; } figure svg { width: 100%; }
td.yes { color: #00694e; }
table.numbers { width: 100%; }
table.numbers td:not(:last-child) { white-space: nowrap; }
table.numbers td:last-child { width: 38%; }
table.numbers tr.no td { font-weight: 600; } table.numbers tr.no td:last-child { font-weight: 400; }
.big { font-size: 1.5rem; font-weight: 700; line-height: 1.25; margin: 4px 0 8px; }
"""


def printed(row: PrintedNumber) -> str:
    """The number with the digits of the print."""
    mantissa, _, exponent = row.printed.partition("e")
    text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}" if exponent else mantissa
    return {"=": "", "<": "< ", ">": "> "}[row.relation] + text.replace("-", "−")


def ours(value: float | None, row: PrintedNumber) -> str:
    """A number with one digit more than the print."""
    if value is None or not math.isfinite(value):
        return "–"
    mantissa, _, exponent = row.printed.partition("e")
    shift = int(exponent or 0)
    decimals = len(mantissa.partition(".")[2]) + 1
    scaled = value / 10.0**shift
    if (abs(scaled) >= 1e4 and decimals > 2) or (exponent and not 0.01 < abs(scaled / float(mantissa)) < 100.0):
        return number(value, 4)
    text = f"{scaled:.{decimals}f}"
    return (f"{text}·10{str(shift).translate(SUPERSCRIPT)}" if exponent else text).replace("-", "−")


def deviation(row: PrintedNumber) -> str:
    """Deviation with its sign; whether it holds for a bound."""
    if row.relation != "=":
        return "holds" if row.agrees else "does not hold"
    if abs(row.deviation) < 1e-9 * abs(row.value):
        return "0"
    sign = "+" if row.deviation > 0.0 else ""
    return sign + number(row.deviation, 2)
