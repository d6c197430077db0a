"""gyroscreen explore: what it names, what it refuses in one line, and how it ends."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import signal
import subprocess
import sys
import urllib.request
import webbrowser
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import UsageError
from workflows.cli import call

pytest.importorskip("bokeh", reason="the extra [explore] is not installed")

from workflows.explore import server
from workflows.explore.choose import kind_of


def test_it_serves_until_ctrl_c(night: Path) -> None:
    command = [sys.executable, "-m", "workflows.cli", "explore", "--results", str(night.parent), "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address) as answer:
            assert b"Night r" in answer.read()
        process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        assert process.wait(60) == 130
    assert said.strip() == "interrupted"


@pytest.mark.parametrize("opened", [False, True])
def test_the_browser_opens_unless_told_otherwise(
    night: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, opened: bool
) -> None:
    seen: list[str] = []

    async def serve(view: Any, port: int, ready: Any) -> None:
        ready("http://127.0.0.1:1/token/")
        await asyncio.sleep(0.05)

    monkeypatch.setattr(server, "serve", serve)
    monkeypatch.setattr(webbrowser, "open", seen.append)
    assert call(["explore", str(night), *([] if opened else ["--no-browser"])]) == 0
    assert seen == (["http://127.0.0.1:1/token/"] if opened else [])
    assert capsys.readouterr().out == "http://127.0.0.1:1/token/\n"


def test_without_bokeh_one_line_says_what_to_install(night: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any) -> None:
    known = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name == "bokeh" else known(name, *more)
    )
    assert call(["explore", str(night)]) == 2
    said = capfd.readouterr().err.strip()
    assert said.splitlines() == [said]
    assert 'pip install "gyroscreen[explore]"' in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "no such run, campaign or lot"),
        (["--results", "{folder}"], "holds no runs"),
        (["{folder}"], "campaign"),
        (["--port", "70000"], "65535"),
    ],
)
def test_wrong_input_is_one_line_with_exit_code_2(arguments: list[str], words: str, tmp_path: Path, capfd: Any) -> None:
    assert call(["explore", "--no-browser", *(one.format(folder=tmp_path) for one in arguments)]) in (2, 5)
    said = capfd.readouterr().err.strip()
    assert words in said
    assert "Traceback" not in said


def test_a_damaged_run_is_an_integrity_error(night: Path, tmp_path: Path, capfd: Any) -> None:
    copy = tmp_path / night.name
    copy.mkdir()
    for path in night.iterdir():
        data = path.read_bytes()
        (copy / path.name).write_bytes(data[:-1] if path.name.startswith("posterior") else data)
    assert call(["explore", str(copy), "--no-browser"]) == 4
    assert "posterior" in capfd.readouterr().err


def test_what_a_path_names(night: Path, tmp_path: Path) -> None:
    assert kind_of(None, night.parent) == ("night", night)
    assert kind_of(night, tmp_path) == ("night", night)
    assert kind_of(night.parent, tmp_path) == ("night", night)
    assert kind_of(Path("r"), night.parent) == ("night", night)
    assert kind_of(Path("latest"), night.parent) == ("night", night)
    (tmp_path / "lot.toml").write_text('file = "table.csv"\n')
    assert kind_of(tmp_path, tmp_path)[0] == "lot"
    assert kind_of(tmp_path / "lot.toml", tmp_path)[0] == "lot"
    campaign = tmp_path / "campaign"
    campaign.mkdir()
    (campaign / "campaign.toml").write_text("[device]\n")
    assert kind_of(campaign, tmp_path)[0] == "campaign"
    with pytest.raises(UsageError, match="no such run"):
        kind_of(Path("other"), night.parent)


def test_other_commands_do_not_load_bokeh() -> None:
    code = "import sys; from workflows.cli import call; call(['explore', '--help']); sys.exit('bokeh' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, env=environment).returncode == 0
