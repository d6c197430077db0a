"""Parts that the pages of campaigns and lots share: text that is announced, tables, rows of controls.

Tables are HTML with escaped text: they need no script, follow the light or dark look, and are read by screen readers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.model import Model
from bokeh.models import Column, InlineStyleSheet, LogAxis, PrintfTickFormatter, Range, Row
from bokeh.models.ui.ui_element import UIElement
from bokeh.models.widgets.inputs import Select
from bokeh.models.widgets.markups import Div
from bokeh.plotting import figure

#: Angle of the names of models on an axis [rad]: side by side they would overlap in a narrow window.
TILT = 0.4
#: The colours are those of the page (look.py), which a part inherits.
_TABLE = """
:host { min-width: 0; max-width: 100%; }
.bk-clearfix { display: block; min-width: 0; max-width: 100%; }
.scroll { overflow-x: auto; max-height: var(--table-height, none); overflow-y: auto; }
table { border-collapse: collapse; font-size: 0.87rem; width: 100%; }
th, td { padding: 3px 10px 3px 0; text-align: right; vertical-align: top; white-space: nowrap; }
th { font-weight: 600; border-bottom: 1px solid var(--muted); position: sticky; top: 0; background: var(--page); }
td { border-bottom: 1px solid var(--rule); }
th:first-child, td:first-child { text-align: left; }
th.words, td.words { text-align: left; white-space: normal; min-width: 14em; }
tr.marked td { font-weight: 600; color: var(--focus); }
p { margin: 0 0 4px; }
pre { margin: 0; overflow-x: auto; font-size: 0.82rem; }
.error { color: var(--error, #d55e00); font-weight: 600; }
"""


def text(content: str = "", *, live: bool = False) -> Div:
    """A part with words; ``live``: a screen reader speaks its changes."""
    spoken = {"role": "status", "aria-live": "polite"} if live else {}
    return Div(
        text=content,
        sizing_mode="stretch_width",
        disable_math=True,
        html_attributes=spoken,
        stylesheets=[InlineStyleSheet(css=_TABLE)],
    )


def paragraphs(lines: Sequence[str]) -> str:
    """Lines as escaped paragraphs."""
    return "".join(f"<p>{escape(line)}</p>" for line in lines if line)


def printed(lines: Sequence[str]) -> str:
    """Lines as the terminal shows them."""
    body = "\n".join(escape(line) for line in lines)
    return f'<pre tabindex="0">{body}</pre>'


def say(part: Div, content: str) -> None:
    """Show ``content`` in a part, which takes no room without any."""
    part.update(text=content, visible=bool(content))


def error_line(line: str) -> str:
    """A line that says what is wrong."""
    return f'<p class="error" role="alert">{escape(line)}</p>' if line else ""


def table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    words: Sequence[int] = (),
    marked: Sequence[int] = (),
    height: str = "",
) -> str:
    """A table of escaped text.

    Parameters
    ----------
    heads, rows : of text; numbers are aligned at the right, the first column at the left.
    words : columns with sentences, which may wrap.
    marked : rows that are told apart.
    height : CSS length beyond which the rows scroll.
    """

    def cells(tag: str, values: Sequence[str]) -> str:
        kinds = (' class="words"' if k in words else "" for k in range(len(values)))
        scope = ' scope="col"' if tag == "th" else ""
        return "".join(f"<{tag}{scope}{kind}>{escape(one)}</{tag}>" for kind, one in zip(kinds, values))

    body = "".join(
        f'<tr class="marked">{cells("td", row)}</tr>' if k in marked else f"<tr>{cells('td', row)}</tr>"
        for k, row in enumerate(rows)
    )
    style = f' style="--table-height: {height}" tabindex="0"' if height else ""
    return f'<div class="scroll"{style}><table><thead><tr>{cells("th", heads)}</tr></thead><tbody>{body}</tbody></table></div>'


def controls(*elements: UIElement) -> Row:
    """Controls side by side, below each other where the window is narrow; none is wider than the window."""
    for one in elements:
        one.styles = {"max-width": "100%"}
    wrapped = InlineStyleSheet(css=":host { flex-wrap: wrap; column-gap: 14px; row-gap: 6px; }")
    return Row(children=list(elements), sizing_mode="stretch_width", stylesheets=[wrapped])


def stacked(*elements: UIElement) -> Column:
    """Elements below each other, as wide as the panel."""
    narrow = InlineStyleSheet(css=":host { min-width: 0; max-width: 100%; }")
    return column(*elements, sizing_mode="stretch_width", spacing=8, stylesheets=[narrow])


def offer(select: Select, options: Mapping[str, str] | Sequence[str]) -> None:
    """Let a control offer ``options``: values, or values with their words."""
    every: list[Any] = list(options.items()) if isinstance(options, Mapping) else list(options)
    select.options = every


def on(model: Model, attribute: str, call: Callable[[], None]) -> None:
    """Call ``call`` when the attribute of a Bokeh model changes."""

    def changed(attr: str, old: object, new: object) -> None:
        call()

    model.on_change(attribute, changed)


def show_range(axis: Range, *values: object, log: bool) -> None:
    """Let an axis show all ``values`` that are finite, and positive on a logarithmic axis, with room at both ends."""
    every = np.concatenate([np.ravel(np.asarray(one, dtype=np.float64)) for one in values])
    every = every[np.isfinite(every) & ((every > 0.0) | (not log))]
    if not every.size:
        return
    low, high = float(every.min()), float(every.max())
    if log:
        room = max((high / low) ** 0.06, 1.2)
        low, high = low / room, high * room
    else:
        room = 0.03 * (high - low) or 0.5
        low, high = low - room, high + room
    axis.update(start=low, end=high, reset_start=low, reset_end=high)


def plain_ticks(drawn: figure) -> None:
    """Few short numbers on logarithmic axes, which would otherwise overlap in a narrow window."""
    for axis in drawn.select({"type": LogAxis}):
        axis.formatter = PrintfTickFormatter(format="%.3g")
        axis.ticker.desired_num_ticks = 4


def legend_above(drawn: figure) -> None:
    """Put the legend of a figure above its frame, where it hides no curve."""
    legend = drawn.legend[0]
    legend.update(orientation="horizontal", border_line_alpha=0.0, background_fill_alpha=0.0, padding=0, margin=2)
    drawn.add_layout(legend, "above")
