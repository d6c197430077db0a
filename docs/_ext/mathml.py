"""Formulas as MathML, written when the manual is built: the pages need no script and no other host."""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.math import get_node_equation_number

log = logging.getLogger(__name__)


def _mathml(latex: str, display: str, node: nodes.Element) -> str:
    try:
        return _adjusted(str(convert(latex, display=display)))
    except Exception as error:  # the converter has many kinds of errors
        log.warning("formula cannot be converted: %s: %s", latex, error, location=node, type="mathml")
        return f"<code>{latex}</code>"


_PRIME, _DOUBLE = "&#x02032;", "&#x02033;"
_MATRIX = r"<mo[^>]*>&#x0*28;</mo>(<mtable)(.*?</mtable>)<mo[^>]*>&#x0*29;</mo>"
_TWO_PRIMES = rf"<msup>(<msubsup>(?:(?!</msubsup>).)*)<mi>{_PRIME}</mi></msubsup><mi>{_PRIME}</mi></msup>"


def _adjusted(text: str) -> str:
    """What only fonts for mathematics draw well, which not every machine has: manual.css draws it by these classes.

    Parentheses around a matrix become its border; primes and dots, which would be tiny, become larger.
    """
    text = re.sub(_MATRIX, r'\1 class="matrix"\2', text)
    text = re.sub(_TWO_PRIMES, rf"\1<mi>{_DOUBLE}</mi></msubsup>", text)
    text = re.sub(rf"<(m[io])>({_PRIME}|{_DOUBLE})</\1>", r'<mo class="accent">\2</mo>', text)
    return re.sub(r"<mo>(&#x000A8;|&#x002D9;)</mo>", r'<mo class="accent">\1</mo>', text)


def _inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(_mathml(node.astext(), "inline", node))
    raise nodes.SkipNode


def _block(writer: Any, node: nodes.math_block) -> None:
    number = ""
    if node["number"]:
        number = f'<span class="eqno">({get_node_equation_number(writer, node)})</span>'
    identifier = f' id="{node["ids"][0]}"' if node["ids"] else ""
    writer.body.append(f'<div class="formula"{identifier}>{_mathml(node.astext(), "block", node)}{number}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer "mathml"."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
