"""Formulas as MathML, written when the manual is built: the pages need no script and no other host."""

import xml.etree.ElementTree as ElementTree
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


_NAMESPACE = "http://www.w3.org/1998/Math/MathML"
_PRIMES = ("\u2032", "\u2033")
_DOTS = ("\u02d9", "\u00a8")
ElementTree.register_namespace("", _NAMESPACE)


def _adjusted(text: str) -> str:
    """What only fonts for mathematics draw well, which not every machine has: manual.css draws it by these classes.

    Parentheses around a matrix become its border; primes stand beside their letter, and dots become larger.
    """
    root = ElementTree.fromstring(text)
    for node in root.iter():
        _beside(node)
        _bordered(node)
        if _is(node, "mo") and node.text in _DOTS:
            node.set("class", "accent")
    return ElementTree.tostring(root, encoding="unicode")


def _is(node: ElementTree.Element, name: str) -> bool:
    return node.tag == f"{{{_NAMESPACE}}}{name}"


def _beside(node: ElementTree.Element) -> None:
    """A prime as a superscript becomes an operator beside the base."""
    primed = (_is(node, "msup") or _is(node, "msubsup")) and node[-1].text in _PRIMES
    if not primed:
        return
    prime = node[-1].text
    node.remove(node[-1])
    base = list(node)
    for one in base:
        node.remove(one)
    inner = ElementTree.SubElement(node, f"{{{_NAMESPACE}}}{'msub' if len(base) == 2 else 'mrow'}")
    inner.extend(base)
    node.tag = f"{{{_NAMESPACE}}}mrow"
    mark = ElementTree.SubElement(node, f"{{{_NAMESPACE}}}mo", {"lspace": "0", "rspace": "0", "class": "prime"})
    mark.text = prime


def _bordered(node: ElementTree.Element) -> None:
    """Parentheses on both sides of a matrix become its class."""
    inside = list(node)
    for before, one, after in zip(inside, inside[1:], inside[2:]):
        around = _is(before, "mo") and _is(after, "mo") and (before.text, after.text) == ("(", ")")
        if _is(one, "mtable") and around:
            one.set("class", "matrix")
            node.remove(before)
            node.remove(after)


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
