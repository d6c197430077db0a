"""Where a page goes: into the folder of its run, or to the file that the user names."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import unwritable
from pipeline.store.run import open_run


def stored_page(page: str, results: Path, run_id: str, name: str, out: Path | None) -> Path:
    """The path of ``page``, which is stored as ``name`` in the folder of the run; or written to ``out``.

    Raises
    ------
    UsageError : the file that the user names cannot be written.
    IncompleteError : the folder of the run cannot.
    """
    if out is not None:
        return written_page(page, out)
    store = open_run(results, run_id)
    store.write_file(name, page.encode("utf-8"))
    return store.folder / name


def written_page(
    page: str, out: Path, next_step: str = "choose another file with --out", what: str = "the page"
) -> Path:
    """``out``, with ``page`` in it.

    Raises
    ------
    UsageError : it cannot be written; the message names ``what`` and ``out``, and ``next_step``.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page, encoding="utf-8")
    except OSError as error:
        raise unwritable(what, out, error, next_step) from None
    return out
