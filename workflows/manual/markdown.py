"""Pieces of Markdown for generated pages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

#: A generated page says so to those who would edit it.
NOTE = "<!-- Generated from the code when the manual is built. -->\n"
_LETTERS = {
    "alpha": "α",
    "beta": "β",
    "gamma": "γ",
    "delta": "δ",
    "eps": "ε",
    "zeta": "ζ",
    "kappa": "κ",
    "rho": "ρ",
    "sigma": "σ",
    "tau": "τ",
    "phi": "φ",
    "psi": "ψ",
    "omega": "ω",
    "Omega": "Ω",
}
_GREEK = re.compile(rf"(?<![A-Za-z.])({'|'.join(_LETTERS)})(?=[0-9]?(?![A-Za-z0-9]))")
_INDEX = re.compile(r"(?<![A-Za-z0-9])([A-Za-zα-ωΩ])\\_([A-Za-z0-9]+)(?![A-Za-z0-9\\])")
_EXPONENT = re.compile(r"\^(-?[0-9]+|T\b)")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells in Markdown; an empty text without rows.  Line breaks and bars in cells are kept from breaking it."""
    lines = [_row(head), _row(["---"] * len(head)), *(_row(row) for row in rows)]
    return "\n".join(lines) + "\n" if len(lines) > 2 else ""


def code(text: str) -> str:
    """``text`` as inline code; an empty text stays empty."""
    if not text:
        return ""
    fence = "``" if "`" in text else "`"
    space = " " if text.startswith("`") or text.endswith("`") else ""
    return f"{fence}{space}{text}{space}{fence}"


def block(text: str, language: str = "text") -> str:
    """``text`` as a block of code."""
    return f"```{language}\n{text.rstrip()}\n```\n"


def plain(text: str) -> str:
    """``text`` with the characters that Markdown would read as markup escaped; double backticks become code.

    Symbols are set as in print: psi_x^2 gets a Greek letter, an index and an exponent.
    """
    parts = text.split("``")
    if len(parts) % 2 == 0:
        parts = [text]
    shown = [code(part) if k % 2 else _typeset(_escaped(part)) for k, part in enumerate(parts)]
    return "".join(shown)


def without_roles(text: str) -> str:
    """``text`` of a docstring with its Sphinx roles as code."""
    return re.sub(r":[a-z:]+:`~?([^`]*)`", r"``\1``", text)


def number(value: float) -> str:
    """A number as short as it is exact to six digits: 1e-05 becomes 1e-5."""
    text = f"{value:g}"
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if mark else text


def _escaped(text: str) -> str:
    for mark in "\\*_[]<>$#{}":
        text = text.replace(mark, f"\\{mark}")
    return text.replace("`", "\\`")


def _typeset(text: str) -> str:
    """Escaped text with Greek letters, and the indices and exponents of symbols of one letter."""
    text = re.sub(r"(?<![A-Za-z_])um(?![A-Za-z])", "µm", text)
    text = _GREEK.sub(lambda found: _LETTERS[found[1]], text)
    text = _INDEX.sub(r"\1<sub>\2</sub>", text)
    return _EXPONENT.sub(lambda found: f"<sup>{found[1].replace('-', '−')}</sup>", text)


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"
