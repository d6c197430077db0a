"""The law of a generic irregularity as LaTeX, from the plain text at the head of its file.

    "What it is: y += s n (rho^2 - 1/2), remark."   ->   "What it is, remark.",  \\Delta q = s\\,n\\,(\\rho^2 - 1/2)

The quantity is called q on the page, because y is also a coordinate on the wafer.
"""

from __future__ import annotations

import re

_LAW = re.compile(r":\s+(y\S* \+= .*?)((?:, | where )(?:x and y|t from|rho is).*)?\.$")
_STEPS = (
    (r"\by(_\w)? \+= ", r"\\Delta q\1 = "),
    (r"\+-", r"\\pm "),
    (r"\bn\((\w+)\)", r"n_\\text{\1}"),
    (r"\^\((\w+) \+ (\w+)\)", r"^{\\text{\1} + \\text{\2}}"),
    (r"\^([a-z]+)", r"^\\text{\1}"),
    (r"\b([bn])([0-9])\b", r"\1_\2"),
    (r"\brho\b", r"\\rho"),
    (r"\bphi\b", r"\\varphi"),
    (r"\b(cos|sin) ", r"\\\1 "),
    (r"(?<!Delt)([\w}]) (?=[\\(a-z])", r"\1\\,"),
)
#: Start of a remark on a law -> start of its sentence.
_REMARKS = {
    "x and y in": "The coordinates x and y are in",
    "t from": "The time t runs from",
    "where rho": "The law holds where rho",
}


def law_as_latex(text: str) -> tuple[str, str]:
    """(sentence without the law, the law as LaTeX); the law is empty where the text states none."""
    found = _LAW.search(text)
    if found is None:
        return text, ""
    law = found[1]
    for pattern, shown in _STEPS:
        law = re.sub(pattern, shown, law)
    remark = (found[2] or "").strip(" ,")
    for start, sentence in _REMARKS.items():
        if remark.startswith(start):
            remark = f" {remark.replace(start, sentence, 1)}."
    return f"{text[: found.start()]}.{remark}", law
