"""The progress of a run: devices of unfinished blocks count, and a bar never goes back."""

from __future__ import annotations

import io
import sys

import pytest

from workflows.screening.progress import progress


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def _shown(monkeypatch: pytest.MonkeyPatch) -> _Terminal:
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("TERM", "xterm")
    return terminal


def test_the_bar_says_that_code_is_loaded_until_the_first_device_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = _shown(monkeypatch)
    with progress(100, 0, quiet=False):
        pass
    assert "loading the numerical code" in terminal.getvalue()
    assert "identifying" not in terminal.getvalue()


def test_the_bar_moves_within_a_block_and_never_back(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = _shown(monkeypatch)
    with progress(100, 10, quiet=False) as shown:
        shown.partly(7)
        shown.partly(3)
    assert "17/100" in terminal.getvalue()
    assert "13/100" not in terminal.getvalue()


def test_lines_count_the_devices_of_unfinished_blocks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("workflows.screening.progress._EVERY_S", 0.0)
    with progress(100, 10, quiet=False) as shown:
        shown.partly(7)
        shown.advance(25)
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("identifying: 17 of 100 devices")
    assert second.startswith("identifying: 35 of 100 devices")
