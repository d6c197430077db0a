"""Every command and example of the manual runs, or states why it does not.

Marks above the blocks (``manual_pages``) say what the suite runs in place of long commands.  As printed, everything runs by
``python -m tests.measure.manual PAGE``, which also renews the shown output and the pictures.
"""

import shutil
from pathlib import Path

import pytest
from conftest import brief
from in_process import InProcess
from manual_pages import EXAMPLES, KINDS, blocks, pages
from manual_session import Session, commands, run_in_process

ROOT = Path(__file__).parents[2]
PAGES = pages(ROOT)
#: A picture of a page is read over slow lines, too.
PICTURE_BYTES = 100_000


def of(page: Path):
    return blocks(page.read_text(encoding="utf-8"), page.relative_to(ROOT).as_posix())


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """Folder after some commands -> made once, whichever page asks first."""
    made: dict[tuple[str, ...], Path] = {}

    def folder(lines: tuple[str, ...], where: str, enter) -> Path:
        if lines not in made:
            path = tmp_path_factory.mktemp("given")
            enter(path)
            Session(path, run_in_process, short=True).prepare(lines, where)
            made[lines] = path
        return made[lines]

    return folder


@pytest.fixture
def small_work(monkeypatch):
    """Short records; devices one after the other in this process; no process for queries, no figures in the page of a run."""
    from manual_work import in_this_process

    brief(monkeypatch)
    in_this_process(monkeypatch)
    monkeypatch.setattr("pipeline.store.query.QueryProcess", InProcess)


@pytest.mark.parametrize("page", [p for p in PAGES if of(p)], ids=lambda p: p.relative_to(ROOT / "docs").as_posix())
def test_the_examples_of_the_page_run(page, tmp_path, monkeypatch, prepared, small_work):
    session = Session(tmp_path, run_in_process, short=True)
    monkeypatch.chdir(tmp_path)
    for block in of(page):
        if (given := block.mark("given")) is not None:
            made = prepared(tuple(commands(given)), block.where, monkeypatch.chdir)
            shutil.copytree(made, tmp_path, dirs_exist_ok=True)
            monkeypatch.chdir(tmp_path)
        session.do(block)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT / "docs").as_posix())
def test_marks_are_complete(page):
    shown = of(page)
    for before, block in zip((None, *shown), shown):
        if block.language == "picture":
            assert block.text.startswith("http") or (page.parent / block.text).stat().st_size <= PICTURE_BYTES, (
                block.where
            )
        if block.mark("output") is not None:
            assert before is not None, block.where
            assert before.language in EXAMPLES, f"{block.where}: the block before prints nothing"
            assert block.text.strip(), f"{block.where}: no output yet; run python -m tests.measure.manual {block.page}"
        reason = block.mark("not run")
        assert reason is None or len(reason) > 8, f"{block.where}: state the reason"
    text = page.read_text(encoding="utf-8")
    assert sum(len(block.marks) for block in shown) == sum(text.count(f"<!-- {kind}") for kind in KINDS), "a stray mark"
