"""Fenced blocks of a page of the manual, with the marks above them.

A mark is a comment in a line of its own (it may go over several lines) between a block and the text before it:

    <!-- not run: REASON -->            the block is only read; the reason is for whoever edits the page
    <!-- run as: COMMANDS -->           the suite runs these lines in place of the block: the same, with less work
    <!-- given: COMMANDS -->            the suite, and whoever renews the page, run these lines first
    <!-- exit: 1 -->                    exit code of the last command of the block (0 where nothing is stated)
    <!-- file: NAME -->                 the block is the content of this file; python is then not executed
    <!-- read as: READER -->            who reads the block: one of ``manual_readers.READERS``
    <!-- output: N lines -->            the block is what the block before printed, or its first N lines
    <!-- drawn by: STATEMENTS -->       above a picture: Python that draws it into the file FILE
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: Languages of blocks that are run or read; others, and blocks without one, are text.
SHELL = ("sh", "bash", "shell", "console")
EXAMPLES = (*SHELL, "python", "toml", "sql")
KINDS = ("not run", "run as", "given", "exit", "file", "read as", "output", "drawn by")

_MARK = re.compile(rf"<!--\s*({'|'.join(KINDS)})\b:?\s*(.*?)\s*-->", re.DOTALL)
_FENCE = re.compile(r"^(`{3,}|~{3,})\s*([^\s`]*)[^\n`]*\n(.*?)^\1[ \t]*$", re.DOTALL | re.MULTILINE)
_PICTURE = re.compile(r"^!\[[^\]]*\]\(([^)]+)\)", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block, or a picture (language "picture", text its path).

    ``first`` and ``last`` are the places of its content in the text of the page, ``line`` counts from 1.
    """

    page: str
    line: int
    language: str
    text: str
    marks: tuple[tuple[str, str], ...]
    first: int
    last: int

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"

    def mark(self, kind: str) -> str | None:
        """Content of the first mark of this kind; ``None`` where there is none."""
        return next((content for name, content in self.marks if name == kind), None)

    @property
    def printed_lines(self) -> int | None:
        """Lines that the block shows of an output; ``None`` where all."""
        found = re.match(r"\d+", self.mark("output") or "")
        return int(found[0]) if found else None


def blocks(text: str, page: str) -> tuple[Block, ...]:
    """The fenced blocks and pictures of a page, in their order."""
    found: list[Block] = []
    fences = list(_FENCE.finditer(text))
    for match in fences:
        found.append(_block(text, page, match, match[2], match[3], match.span(3)))
    for match in _PICTURE.finditer(text):
        if not any(fence.start() <= match.start() < fence.end() for fence in fences):
            found.append(_block(text, page, match, "picture", match[1], match.span(1)))
    return tuple(sorted(found, key=lambda block: block.first))


def _block(text: str, page: str, match: re.Match[str], language: str, content: str, span: tuple[int, int]) -> Block:
    return Block(page, text.count("\n", 0, match.start()) + 1, language, content, tuple(_marks(text, match)), *span)


def _marks(text: str, match: re.Match[str]) -> Iterator[tuple[str, str]]:
    """Marks between a block and what stands before it: comments and blank lines alone."""
    before = text[: match.start()].rstrip()
    found: list[tuple[str, str]] = []
    while before.endswith("-->"):
        begin = before.rindex("<!--")
        if (mark := _MARK.fullmatch(before[begin:])) is not None:
            found.append((mark[1], mark[2]))
        before = before[:begin].rstrip()
    return reversed(found)


def pages(root: Path) -> tuple[Path, ...]:
    """The pages of the manual: what stands below docs/, without what a build wrote."""
    folder = root / "docs"
    return tuple(
        path
        for path in sorted(folder.rglob("*.md"))
        if not any(p.startswith("_") for p in path.relative_to(folder).parts)
    )
