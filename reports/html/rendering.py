"""From frozen content to HTML: the environment that every page shares.

Autoescape is on; only figures (:class:`reports.html.style.Drawing`) enter as markup.
All numbers are formatted here: values are rounded according to their sd, shares are shown in percent.
"""

from __future__ import annotations

import math
from pathlib import Path

import jinja2
from markupsafe import Markup

from ..words.quantities import SUPERSCRIPT, UNITS, label, limit_words, percent, percent_range
from ..words.rules import rule_words

_TEMPLATES = Path(__file__).parent / "templates"
_DASH = "–"


def environment() -> jinja2.Environment:
    """Template environment with autoescape, strict names and the filters of this module."""
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters.update(
        number=number,
        measured=measured,
        interval=interval,
        estimate=estimate,
        percent=percent,
        quantity=label,
        limit=limit_words,
        rule=rule_words,
        svg=Markup,
        unit=unit,
    )
    env.globals.update(percent_range=percent_range)
    return env


def stylesheet(*more: str) -> Markup:
    """The style of all pages and of the named files, inlined by the base template."""
    return Markup("".join((_TEMPLATES / name).read_text(encoding="utf-8") for name in ("style.css", *more)))


def unit(quantity: str) -> str:
    """Unit of a quantity; empty for a pure number."""
    return UNITS.get(quantity, "")


def number(value: float | None, digits: int = 3) -> str:
    """A number with ``digits`` significant digits; a dash if it is not known."""
    if value is None or math.isnan(value):
        return _DASH
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    # Numbers of four to six digits are easier to read without a power of ten.
    if 10.0**digits <= abs(value) < 1e6:
        return _typeset(f"{value:.0f}")
    # The alternate form leaves a trailing point after a one-digit mantissa.
    return _typeset(f"{value:#.{digits}g}".replace(".e", "e").rstrip("."))


def measured(value: float, sd: float) -> str:
    """value ± sd; the sd has two significant digits, the value the same number of decimals."""
    if not math.isfinite(value):
        return _DASH
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{number(value, 6)} ± ?"
    if max(abs(value), sd) >= 1e6:
        return estimate((value, sd))
    decimals = _decimals(sd)
    return f"{_fixed(value, sd, decimals)} ± {_fixed(sd, sd, decimals)}"


def estimate(found: tuple[float | None, float | None] | None) -> str:
    """(value, sd) as "value ± sd" without line breaks; a power of ten outside the brackets far from 1; a dash for none."""
    value, sd = found or (None, None)
    if value is None or not math.isfinite(value):
        return _DASH
    spread = sd if sd is not None and math.isfinite(sd) and sd > 0.0 else 0.0
    largest = max(abs(value), spread)
    scale = 0 if 1e-2 <= largest < 1e5 or largest == 0.0 else math.floor(math.log10(largest))
    value, spread = value / 10.0**scale, spread / 10.0**scale
    text = measured(value, spread).replace(" ", "\u00a0") if spread else number(value, 4 if scale else 6)
    if scale == 0:
        return text
    return f"{f'({text})' if spread else text}·10{str(scale).translate(SUPERSCRIPT)}"


def interval(low: float, high: float, sd: float) -> str:
    """low to high, with decimals according to the sd."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return _DASH
    spread = sd if math.isfinite(sd) and sd > 0.0 else abs(high - low)
    decimals = _decimals(spread) if spread > 0.0 else 3
    return f"{_fixed(low, spread, decimals)} to {_fixed(high, spread, decimals)}"


def _decimals(sd: float) -> int:
    """Decimals that show two significant digits of the sd."""
    return 1 - math.floor(math.log10(float(f"{sd:.1e}")))


def _fixed(value: float, sd: float, decimals: int) -> str:
    # Beyond eight decimals a small number is easier to read as a power of ten with the same last digit.
    if decimals > 8 and value != 0.0:
        digits = max(0, math.floor(math.log10(abs(value))) + decimals)
        return _typeset(f"{value:.{digits}e}")
    return _typeset(f"{round(value, decimals):.{max(0, decimals)}f}")


def _typeset(text: str) -> str:
    mantissa, _, exponent = text.partition("e")
    if exponent:
        return f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}".replace("-", "−")
    return text.replace("-", "−")
