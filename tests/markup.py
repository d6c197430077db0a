# ruff: noqa: E501 - one payload a place; letters that look like others are the point
"""100 payloads that are markup or script in a page that does not escape them, and what a page must not contain then."""

from __future__ import annotations

from html.parser import HTMLParser

_TAGS = (
    "script",
    "img",
    "svg",
    "iframe",
    "object",
    "embed",
    "style",
    "link",
    "meta",
    "base",
    "form",
    "input",
    "a",
    "body",
    "math",
)
_ATTRIBUTES = (
    "onerror=alert(1)",
    "onload=alert(1)",
    "href=javascript:alert(1)",
    "src=//x",
    "style=background:url(//x)",
)
_QUOTES = ('"><b>', "'><b>", "`><b>", '" onmouseover=alert(1) x="', "' onfocus=alert(1) autofocus x='", "&quot;><b>")
_MORE = (
    "</td></table><h1>x</h1>", "</script><script>alert(1)</script>", "</style><style>*{}</style>", "</title><u>", "</svg><u>", "--><u>",
    "<!--", "<![CDATA[<u>]]>", "<?xml version='1.0'?>", "<!DOCTYPE x>", "{{7*7}}", "{% raw %}", "${7*7}", "<%= 7 %>", "javascript:alert(1)",
    "data:text/html,<u>", "\u003cu\u003e", "&#60;u&#62;", "%3Cu%3E", "<u\x00>", "<\u200bu>", "＜u＞", "<U ONCLICK=x>", "<u/x=y>", "</",
)  # fmt: skip

PAYLOADS: tuple[str, ...] = (
    *(f"<{tag}>" for tag in _TAGS),
    *(f"<{tag} {attribute}>" for tag in _TAGS[:10] for attribute in _ATTRIBUTES),
    *(f"</{tag}>" for tag in _TAGS[:4]),
    *_QUOTES,
    *_MORE,
)


class Markup(HTMLParser):
    """Tags and attributes of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the tag with each of its attributes."""
        self.names |= {tag, *(f"{tag} {name}" for name, _ in attrs)}


def added(page: str, plain: str) -> set[str]:
    """Tags and attributes that ``page`` has and the same page with plain names has not."""
    return Markup(page).names - Markup(plain).names
