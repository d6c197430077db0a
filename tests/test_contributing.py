"""docs/CONTRIBUTING.md names files and options that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_the_paths_that_it_names_exist():
    quoted = re.findall(r"`((?:tests|pipeline|populations|reports|workflows|docs|\.ci)/[\w./-]*)`", TEXT)
    linked = [f"docs/{path}" for path in re.findall(r"\]\(([\w./-]+)\)", TEXT)]
    run = re.findall(r"(?<= )(tests/[\w/.]+)(?= |\n)", TEXT)
    assert len(quoted) > 20
    assert len(linked) > 5
    assert run
    assert not [path for path in (*quoted, *linked, *run) if not (ROOT / path).exists()]


def test_modules_that_it_runs_exist():
    modules = re.findall(r"python -m ([\w.]+)", TEXT)
    assert "tests.bench" in modules
    for name in set(modules) - {"pytest", "venv"}:
        path = ROOT.joinpath(*name.split("."))
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), name
