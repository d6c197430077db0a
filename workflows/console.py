"""Text for terminals that cannot show every character: cp1252, ASCII, or a pipe under LANG=C."""

from __future__ import annotations

import codecs
import io
import sys
import unicodedata

_HANDLER = "gyroscreen"
#: Letters have their names (sigma); these signs have none that reads well.
_SIGNS = {
    "\u00b1": "+-", "\u2212": "-", "\u2013": "-", "\u2026": "...", "\u00b7": "*", "\u2264": "<=", "\u2265": ">=",
    "\u221a": "sqrt", "\u00b0": " deg", "\u2032": "'", "\u2033": "''", "\u201c": '"', "\u201d": '"', "\u00bd": "1/2",
    "\u2501": "-", "\u2588": "#",
}  # fmt: skip


def survive_any_encoding() -> None:
    """Write characters that stdout or stderr cannot encode in ASCII instead of failing."""
    codecs.register_error(_HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_HANDLER)


def plain_text(text: str) -> str:
    """``text`` in ASCII: sigma, +-, ^-9; "?" where nothing reads well."""
    return "".join(one if one.isascii() else _spelled(one) for one in text)


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return plain_text(error.object[error.start : error.end]), error.end


def _spelled(one: str) -> str:
    name = unicodedata.name(one, "")
    if one in _SIGNS:
        return _SIGNS[one]
    if name.startswith("GREEK"):
        word = name.split("LETTER ")[-1].split(" WITH")[0]
        return word.lower() if "SMALL" in name else word.capitalize()
    # A superscript minus decomposes to a minus that is not ASCII; an accent alone is dropped.
    parts = (_SIGNS.get(part, part if part.isascii() else "") for part in unicodedata.normalize("NFKD", one))
    return "".join(parts) or ("" if unicodedata.combining(one) else "?")
