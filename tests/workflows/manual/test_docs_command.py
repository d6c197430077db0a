"""gyroscreen docs: builds once, prints the path, opens the browser where it is wanted; faults are one typed line."""

import webbrowser
from pathlib import Path

import pytest

from workflows.cli import call
from workflows.commands import docs
from workflows.manual import build as building
from workflows.manual import sources


@pytest.fixture
def built(monkeypatch, tmp_path):
    """The folders that were built, in place of the build, and the addresses that were opened."""
    folders, opened = [], []

    def build(found, pages, out, **how):
        folders.append((out, how))
        out.mkdir(parents=True, exist_ok=True)
        (out / "index.html").write_text("<p>manual</p>")
        return out / "index.html"

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(docs, "build", build)
    monkeypatch.setattr(docs, "generated_pages", lambda command_line: {"names.md": " ".join(command_line.commands)})
    monkeypatch.setattr(webbrowser, "open", opened.append)
    return folders, opened


def test_the_manual_is_built_once_and_opened(built, capsys, tmp_path):
    folders, opened = built
    assert call(["docs"]) == 0
    out, errors = capsys.readouterr()
    page = Path(out.strip())
    assert page.exists()
    assert page.is_relative_to(tmp_path / "cache" / "gyroscreen" / "manual")
    assert "building the manual" in errors
    assert opened == [page.as_uri()]
    assert call(["docs", "--no-open"]) == 0
    out, errors = capsys.readouterr()
    assert (Path(out.strip()), errors) == (page, "")
    assert len(folders) == len(opened) == 1


def test_changed_sources_are_built_again_and_old_builds_are_forgotten(built, monkeypatch, capsys):
    folders, _ = built
    for k in range(5):
        monkeypatch.setattr(sources.ManualSources, "digest", lambda self, k=k: f"{k}")
        assert call(["docs", "--no-open"]) == 0
    assert len(folders) == 5
    assert len(list(folders[0][0].parent.iterdir())) == 3
    assert folders[-1][0].exists()


def test_options_reach_the_build(built, tmp_path):
    folders, _ = built
    assert call(["docs", "--no-open", "--no-notebooks", "--strict", "--out", str(tmp_path / "site")]) == 0
    assert folders == [(tmp_path / "site", {"strict": True, "notebooks": False})]


def test_without_the_extra_one_line_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = building.importlib.util.find_spec
    monkeypatch.setattr(
        building.importlib.util, "find_spec", lambda name: None if name in ("sphinx", "myst_nb") else found(name)
    )
    assert call(["docs", "--no-open"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "sphinx, myst_nb" in line
    assert 'pip install "gyroscreen[docs]"' in line


def test_an_installation_without_sources_says_so(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(sources, "_HERE", tmp_path / "site-packages" / "workflows" / "manual")
    assert call(["docs", "--no-open"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "does not contain the sources of the manual" in line


def test_sources_in_the_wheel_come_before_a_stranger_s_folder(monkeypatch, tmp_path):
    here = tmp_path / "site-packages" / "workflows" / "manual"
    for root in (here / "sources", tmp_path / "site-packages"):
        (root / "docs").mkdir(parents=True)
        for name in ("docs/conf.py", "CHANGELOG.md", "CITATION.cff"):
            (root / name).write_text("")
    monkeypatch.setattr(sources, "_HERE", here)
    assert sources.find_sources().root == here / "sources"


def test_a_folder_of_something_else_is_refused(tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    assert call(["docs", "--no-open", "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: the folder for the manual holds something else")
    assert (tmp_path / "thesis.txt").exists()
