"""Signals, full disks and clocks that go back: what is committed stays, and the command says how to go on."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import UsageError
from pipeline.store import lock
from pipeline.store.read import list_runs, read_run
from pipeline.store.run import create_run
from tests.stub_runs import run_arguments, stub_block, stub_runs
from workflows.cli import call
from workflows.process import end_like_ctrl_c
from workflows.screening import outcome
from workflows.screening.worker_process import leave_sign


@pytest.fixture
def handlers() -> Iterator[None]:
    """The handlers of a command."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        # Under nohup the suite inherits an ignored SIGHUP, which stays ignored.
        signal.signal(number, signal.SIG_DFL)
    end_like_ctrl_c()
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize(("number", "moment"), [(signal.SIGTERM, "block"), (signal.SIGHUP, "page")])
def test_a_signal_ends_a_run_like_ctrl_c(number, moment, tmp_path, monkeypatch, capfd):
    def block(source: Any, at: Any) -> Any:
        if moment == "block" and at.index == 1:
            signal.raise_signal(number)
        return stub_block()(source, at)

    stub_runs(monkeypatch, block)
    if moment == "page":
        monkeypatch.setattr(outcome, "rendered_report", lambda *_: signal.raise_signal(number))
    assert call(run_arguments(tmp_path)) == 130
    stored = {"block": 2, "page": 4}[moment]
    message = capfd.readouterr().err.strip().splitlines()[-1]
    assert message.startswith(f"interrupted; {stored} of 4 devices are stored; next: gyroscreen run --resume ")
    stub_runs(monkeypatch)
    assert call(message.split("next: gyroscreen ")[1].split()) == 0
    assert read_run(tmp_path / "results").devices.num_rows == 4
    assert (list_runs(tmp_path / "results")[0].status, call(["verify", "--results", str(tmp_path / "results")])) == (
        "complete",
        0,
    )


def test_output_that_cannot_be_written_is_no_internal_error(monkeypatch, capfd):
    with Path("/dev/full").open("w") as full, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", full)
        assert call(["--version"]) == 3
    assert "the output cannot be written: no space left on device" in capfd.readouterr().err


def test_a_full_temporary_folder_costs_no_device(tmp_path: Path) -> None:
    leave_sign(str(tmp_path / "none"), "key", 3, 60.0)


def test_a_new_run_is_the_latest_although_the_clock_was_set_back(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.store.run._now", lambda: "2999-12-31T23:59:59.999+00:00")
        create_run(tmp_path, "first", "", {})
    create_run(tmp_path, "b", "", {})
    create_run(tmp_path, "a", "", {})
    assert [run.run_id for run in list_runs(tmp_path)] == ["first", "b", "a"]
    assert read_run(tmp_path).manifest.created == "3000-01-01T00:00:00.001+00:00"


@pytest.mark.parametrize(("call_", "reason"), [("open", errno.ENOSPC), ("flock", errno.ENOLCK)])
def test_a_run_that_cannot_be_locked_is_incomplete(call_, reason, tmp_path, monkeypatch, capfd):
    """A full disk, and a network file system that passes no locks on."""
    stub_runs(monkeypatch)
    opened = os.open

    def refused(path: Any, *arguments: Any) -> int:
        if call_ == "flock" or str(path).endswith(lock.NAME):
            raise OSError(reason, os.strerror(reason), str(path))
        return opened(path, *arguments)

    create_run(tmp_path, "stopped", "", {})
    monkeypatch.setattr(lock.os if call_ == "open" else lock.fcntl, call_, refused)
    assert call(["run", "--resume", "latest", "--out", str(tmp_path)]) == 3
    message = capfd.readouterr().err
    assert os.strerror(reason) in message
    assert "--resume" in message


def test_a_lock_whose_holder_cannot_be_written_holds(tmp_path, monkeypatch):
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(lock.os, "pwrite", full)
    with lock.one_writer(tmp_path), pytest.raises(UsageError, match="another process"), lock.one_writer(tmp_path):
        pass
