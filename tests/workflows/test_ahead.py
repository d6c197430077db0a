"""A command that finds an empty cache lets a second process compile the loops of a search for effects."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from workflows import ahead

COMPILED = "from pipeline.experiment.forward.ahead import is_compiled; print(is_compiled())"


class Started:
    """Notes the processes that are started, and what becomes of them."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def __call__(self, command: list[str], **_: Any) -> Started:
        self.said.append(command[-1])
        return self

    def kill(self) -> None:
        self.said.append("killed")

    def wait(self) -> None:
        self.said.append("waited for")


@pytest.mark.parametrize(("compiled", "cores"), [(True, 2), (False, 1)])
def test_nothing_is_started_without_need_or_without_a_second_core(
    compiled: bool, cores: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = Started()
    monkeypatch.setattr(ahead.subprocess, "Popen", started)
    monkeypatch.setattr(ahead, "is_compiled", lambda: compiled)
    monkeypatch.setattr(ahead, "usable_cores", lambda: cores)
    with ahead.compiled_ahead():
        pass
    assert started.said == []


def test_a_thread_loads_what_is_cached_until_the_command_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "is_compiled", lambda: True)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 2)
    loaded: list[str] = []
    first, ended = threading.Event(), threading.Event()

    def slow() -> None:
        loaded.append(threading.current_thread().name)
        first.set()
        assert ended.wait(10.0)

    monkeypatch.setattr(ahead, "needed_loops", lambda: (slow, lambda: loaded.append("one more")))
    inside = ahead.compiled_ahead()
    inside.__enter__()
    assert first.wait(10.0)
    threading.Timer(0.1, ended.set).start()
    assert not inside.__exit__(None, None, None)
    # What began has ended, in another thread, and nothing began after the command had ended.
    assert len(loaded) == 1
    assert loaded[0] != threading.current_thread().name
    assert not any(thread.name == loaded[0] for thread in threading.enumerate())


def test_the_process_ends_with_the_command_even_if_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    started = Started()
    monkeypatch.setattr(ahead.subprocess, "Popen", started)
    monkeypatch.setattr(ahead, "is_compiled", lambda: False)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 2)
    inside = ahead.compiled_ahead()
    inside.__enter__()
    assert started.said == ["workflows.ahead"]
    assert not inside.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert started.said == ["workflows.ahead", "killed", "waited for"]


def python(*arguments: str, cache: Path | None = None) -> str:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    call = [sys.executable, "-P", *arguments]
    return subprocess.run(call, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def test_an_empty_cache_is_known_until_the_largest_loop_is_in_it(tmp_path: Path) -> None:
    assert python("-c", COMPILED, cache=tmp_path) == "False"
    loop = "from pipeline.experiment.forward.compiled import compiled_deviation; compiled_deviation(4)"
    assert python("-c", f"{loop}; {COMPILED}", cache=tmp_path) == "True"


def test_the_process_compiles_the_loops() -> None:
    python("-m", "workflows.ahead")
    assert python("-c", COMPILED) == "True"
