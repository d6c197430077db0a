"""Renew the shown output and the pictures of pages of the manual: every command runs as printed, in a folder of its own.

    PYTHONPATH=tests python -m tests.measure.manual docs/tutorials/bench.md ..      pages; without any: all that show output
    PYTHONPATH=tests python -m tests.measure.manual --keep FOLDER docs/..           the folder stays, to look at what was made

The page is rewritten; `git diff` shows what changed.  A command that ends with another code than the page states ends the
program.
"""

from __future__ import annotations

import argparse
import os
import re
import tempfile
from pathlib import Path

from manual_pages import Block, blocks, pages
from manual_session import Session, commands, run_by_shell
from PIL import Image

ROOT = Path(__file__).parents[2]


def renewed(page: Path, folder: Path) -> str:
    """The text of a page with fresh output; pictures are drawn beside it."""
    text = page.read_text(encoding="utf-8")
    session, changes = Session(folder, run_by_shell, short=False), []
    os.chdir(folder)
    for block in blocks(text, page.relative_to(ROOT).as_posix()):
        if (before := block.mark("given")) is not None:
            session.prepare(commands(before), block.where)
        if block.mark("output") is not None:
            changes.append((block.first, block.last, shown(session.printed, block, folder)))
        elif (drawn := block.mark("drawn by")) is not None:
            given = {"FILE": page.parent / block.text, "few_colours": few_colours}
            exec(compile(drawn, block.where, "exec"), session.names | given)
            few_colours(page.parent / block.text)
        else:
            session.do(block)
        print(f"{block.where}: {block.language or 'text'}", flush=True)
    for first, last, output in reversed(changes):
        text = text[:first] + output + text[last:]
    return text


def few_colours(file: Path) -> None:
    """A drawing with 64 colours: a third of the bytes, and no difference that is seen."""
    if file.suffix == ".png":
        with Image.open(file) as picture:
            smaller = picture.convert("RGB").quantize(64, dither=Image.Dither.NONE)
        smaller.save(file, optimize=True)


def shown(printed: str, block: Block, folder: Path) -> str:
    """What a command printed, without the path of the folder and trailing blanks, as long as the block says."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", printed).replace(f"{folder}/", "")
    lines = [line.rstrip() for line in plain.strip("\n").splitlines()]
    most = block.printed_lines
    kept = lines if most is None or len(lines) <= most else [*lines[:most], ".."]
    return "\n".join(kept) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description="Renew the output and pictures of pages of the manual.")
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    chosen = [page.resolve() for page in given.pages] or [
        p for p in pages(ROOT) if "<!-- output" in p.read_text("utf-8")
    ]
    for page in chosen:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) if given.keep is None else given.keep.resolve() / page.stem
            folder.mkdir(parents=True, exist_ok=True)
            text = renewed(page, folder)
            os.chdir(ROOT)
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
