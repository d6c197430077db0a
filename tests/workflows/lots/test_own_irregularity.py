"""docs/how-to/add-an-irregularity.md: an own irregularity that is hidden in a lot is found by the loop, as the page says."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from workflows.cli import call

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "add-an-irregularity.md"


def test_the_commands_of_the_page_find_what_they_hide(tmp_path, monkeypatch, capsys):
    text = PAGE.read_text(encoding="utf-8").partition("## Let a measured lot show")[2]
    python, toml, commands = (re.search(rf"```{kind}\n(.*?)```", text, re.S)[1] for kind in ("python", "toml", "sh"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "edge_bead.py").write_text(python, encoding="utf-8")
    (tmp_path / "mine.toml").write_text(toml, encoding="utf-8")
    simulate, diagnose, refine = (shlex.split(line, comments=True)[1:] for line in commands.splitlines())
    assert call(simulate) == 0
    truth = json.loads((tmp_path / "hidden" / "truth.json").read_text(encoding="utf-8"))
    assert truth["irregularities"] == {"edge_bead": {"rim_pct": 3.0}}
    capsys.readouterr()
    assert call([*diagnose, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "edge_bead.pattern" in [one["part"] for one in found["candidates"][:3]]
    # A page takes three quarters of the time of the command, and test_lot_commands makes one.
    assert refine[-2:] == ["--out", "page"]
    assert call([*refine[:-2], "--json"]) == 0
    ladder = json.loads(capsys.readouterr().out)
    assert ladder["irregularities"] == ["edge_bead.pattern"]
    assert ladder["ladder"][-1]["status"] == "confirmed"
    pattern = ladder["patterns"]["edge_bead.pattern"]
    # The candidate has a trial size of 1 %.
    assert pattern["ratio"] == pytest.approx(3.0, abs=3.0 * pattern["sd"])
