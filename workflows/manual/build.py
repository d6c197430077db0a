"""Build the manual: copy the sources, add the generated pages, run Sphinx on the copy, put the site in place by one rename."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from pipeline.errors import ConfigError, NegativeError, UsageError, unwritable
from reports.words.manual import CORRECT, CORRECT_OR_SKIP, NOT_BUILT

from .sources import ManualSources

#: What the extra [docs] installs, by the names of the modules.
_NEEDS = ("sphinx", "myst_nb", "pydata_sphinx_theme", "sphinx_design", "latex2mathml", "arviz_base")
_SHOWN = 20
#: A line of Sphinx that names a fault, or the last line of a traceback, such as that of a notebook.
_FAULT = re.compile(r"\b(WARNING|ERROR): |^\s*[\w.]*(Error|Exception): ")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
#: A file of every site that Sphinx builds.
_MARK = "objects.inv"


def check(out: Path) -> None:
    """Check that the manual can be built into ``out``.

    Raises
    ------
    ConfigError : a package of the extra [docs] is not installed.
    UsageError : ``out`` holds something else than an earlier build.
    """
    missing = [name for name in _NEEDS if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(
            f"the manual needs packages that are not installed: {', '.join(missing)}",
            allowed="the extra [docs]",
            next_step='pip install "gyroscreen[docs]", or from the project\'s folder: pip install ".[docs]"',
        )
    if out.exists() and not (out / _MARK).exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(
            "the folder for the manual holds something else",
            value=str(out),
            allowed="a new or empty folder, or one that holds an earlier build",
            next_step="choose another folder",
        )


def build(
    sources: ManualSources, pages: Mapping[str, str], out: Path, *, strict: bool = False, notebooks: bool = True
) -> Path:
    """Build the manual into the folder ``out``; returns its first page.

    Parameters
    ----------
    pages : path below docs/ -> text of the generated pages and pictures.
    strict : every warning of Sphinx is an error.
    notebooks : execute the notebooks; without it they show their code alone.

    Raises
    ------
    ConfigError : a package of the extra [docs] is not installed.
    UsageError : ``out`` cannot be written, or holds something else than an earlier build.
    NegativeError : Sphinx failed, or warned while ``strict``.
    """
    check(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="manual-", dir=out.parent) as scratch:
            work = Path(scratch)
            staged(sources, pages, work)
            _sphinx(work / "docs", work / "site", strict, notebooks)
            if out.exists():
                shutil.rmtree(out)
            (work / "site").rename(out)
    except OSError as error:
        raise unwritable("the manual", out, error) from None
    return out / "index.html"


def staged(sources: ManualSources, pages: Mapping[str, str], work: Path) -> None:
    """Write the sources, with the generated ``pages``, into the empty folder ``work``."""
    for path in sources.files:
        target = work / path.relative_to(sources.root)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    for name, content in pages.items():
        target = work / "docs" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(content, encoding="utf-8")
    for notebook in (work / "docs").rglob("*.ipynb"):
        page = notebook.with_suffix(".md")
        if page.exists():
            # A page and a notebook would have one name in the site.
            other = notebook.with_stem(f"{notebook.stem}-executed")
            notebook.rename(other)
            text = page.read_text(encoding="utf-8")
            page.write_text(text.replace(f"]({notebook.name})", f"]({other.name})"), encoding="utf-8")


def _sphinx(pages: Path, site: Path, strict: bool, notebooks: bool) -> None:
    mode = "force" if notebooks else "off"
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-b",
        "html",
        "-j",
        "auto",
        "-T",
        "-D",
        f"nb_execution_mode={mode}",
    ]
    command += ["-W", "--keep-going"] if strict else []
    # The interpreter's import path goes with it: an installation may live beside the working folder.
    path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path, "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    done = subprocess.run(
        [*command, str(pages), str(site)],
        check=False,
        capture_output=True,
        text=True,
        env=environment,
        stdin=subprocess.DEVNULL,
    )
    if done.returncode:
        lines = [_COLOUR.sub("", line) for line in done.stderr.splitlines() if line.strip()]
        faults = list(dict.fromkeys(line.strip() for line in lines if _FAULT.search(line))) or lines[-_SHOWN:]
        shown = "\n".join(line.replace(f"{pages}{os.sep}", "docs/") for line in faults[:_SHOWN])
        raise NegativeError(NOT_BUILT.format(faults=shown), next_step=CORRECT if strict else CORRECT_OR_SKIP)
