"""Every exit code of docs/reference/exit-codes.md, each produced by the command."""

from __future__ import annotations

import ctypes
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.errors import IncompleteError
from pipeline.inference.identify import Identification
from pipeline.learning.answers import ComparisonAnswer, RefinementAnswer
from pipeline.store.read import read_run
from tests.pipeline.experiment.checks.planted_faults import healthy
from tests.stub_runs import run_arguments, stub_block, stub_runs
from workflows.cli import call
from workflows.commands import learn
from workflows.device import identified as identify_device_module
from workflows.process import deaf_children, repeat_lost_interrupts
from workflows.screening import batch
from workflows.screening.block import BlockTables, DeviceBlock

DOCS = Path(__file__).parents[2] / "docs" / "reference" / "exit-codes.md"
Case = Callable[[Path, pytest.MonkeyPatch], list[str]]


def _interrupted(*_: Any) -> Any:
    raise KeyboardInterrupt


def _half_passes(source: Any, at: DeviceBlock) -> BlockTables:
    return stub_block("ok" if at.index else "misfit")(source, at)


def _run(block: Any = None, text: str = "") -> Case:
    def case(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
        stub_runs(patch, block)
        return run_arguments(tmp, text=text)

    return case


def _without_worker(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
    def in_parallel(*_: Any, **__: Any) -> Any:
        raise IncompleteError("no worker is left")

    stub_runs(patch)
    patch.setattr(batch, "guarded_in_parallel", in_parallel)
    return run_arguments(tmp)


def _damaged(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
    stub_runs(patch)
    assert call(run_arguments(tmp)) == 0
    table = next((tmp / "results").glob("run=*/devices-00000.parquet"))
    table.write_bytes(table.read_bytes()[:-1])
    return ["verify", "--results", str(tmp / "results")]


def _alarmed(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
    stub_runs(patch)
    assert call(run_arguments(tmp)) == 0
    return ["report", "--results", str(tmp / "results"), "--against", "last:5", "--alarm", "yield.max=0.5"]


def _campaign(tmp: Path) -> str:
    from pipeline.experiment.campaign import write_campaign

    write_campaign(healthy(), tmp / "campaign")
    return str(tmp / "campaign")


def _identify(status: str) -> Case:
    def case(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
        found = Identification({"device_id": "A17", "status": status, "status_reason": "why"}, {})
        patch.setattr(identify_device_module, "identify_device", lambda *_, **__: found)
        return ["identify", _campaign(tmp)]

    return case


def _answered(command: str, answer: Any) -> Case:
    def case(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
        patch.setattr(learn, f"{command}_measurement", lambda *_: SimpleNamespace(answer=answer))
        return [command, _campaign(tmp), "--json"]

    return case


def _ladder(verdict: str) -> RefinementAnswer:
    return RefinementAnswer((), verdict, (), (), {}, {}, (), 1.0, "", "no start")


def _compared(fit_ok: bool) -> ComparisonAnswer:
    return ComparisonAnswer({}, {}, (), {}, fit_ok, "no start")


def _demo(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
    patch.setattr(learn, "refine_measurement", _interrupted)
    return ["demo", "--seed", "1", "--out", str(tmp / "demo")]


def _unreadable(tmp: Path, _: pytest.MonkeyPatch) -> list[str]:
    (tmp / "record.csv").write_text("time_s,drive1_V\n0.0,nan\n")
    return ["check", str(tmp / "record.csv")]


def _internal(tmp: Path, patch: pytest.MonkeyPatch) -> list[str]:
    patch.setattr(learn, "read_measurement", lambda *_: 1 / 0)
    return ["compare", str(tmp)]


CASES: dict[str, tuple[int, Case, str]] = {
    "run: devices were identified": (0, _run(), ""),
    "run: yield below the target": (1, _run(_half_passes, "[targets]\nyield_min = 1.0\n"), "yield_min"),
    "run: no device could be identified": (
        1,
        _run(stub_block("fit_failed", "no maximum")),
        "4 of 4 devices fit failed",
    ),
    "report --against: an alarm that the user set": (1, _alarmed, "error: alarm: Yield 100 %"),
    "identify: status misfit": (1, _identify("misfit"), "gyroscreen diagnose"),
    "identify: status fit_failed": (1, _identify("fit_failed"), "gyroscreen check"),
    "identify: status not_converged": (0, _identify("not_converged"), ""),
    "compare: fit_ok is false": (1, _answered("compare", _compared(False)), "no start"),
    "compare: fit_ok is true": (0, _answered("compare", _compared(True)), ""),
    "refine: verdict fit_failed": (1, _answered("refine", _ladder("fit_failed")), "no start"),
    "refine: verdict unknown": (1, _answered("refine", _ladder("unknown")), "--effects"),
    "refine: verdict class": (0, _answered("refine", _ladder("class")), ""),
    "usage or configuration": (2, _run(text="[identification]\norder = 1\n"), "identification.order"),
    "run: the drive does not enter the band": (
        2,
        _run(text="[experiment]\nstart_hz = [1000.0, 2000.0]\nstop_hz = [2000.0, 1000.0]\n"),
        "400 to 700 Hz",
    ),
    "run: the modes are outside the band": (
        2,
        _run(text="[identification]\nlow_hz = 400.0\nhigh_hz = 450.0\n"),
        "three modes",
    ),
    "run: no worker is left": (3, _without_worker, "no worker"),
    "verify: a stored table has changed": (4, _damaged, "devices-00000.parquet"),
    "check: the measurement is unreadable": (5, _unreadable, "error: "),
    "a defect of gyroscreen": (70, _internal, "--debug"),
    "run: interrupted with Ctrl-C": (130, _run(_interrupted), "gyroscreen run --resume"),
    "demo: interrupted with Ctrl-C": (130, _demo, "interrupted"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_exit_code_of(case, tmp_path, monkeypatch, capfd):
    code, arguments, words = CASES[case]
    assert call(arguments(tmp_path, monkeypatch)) == code
    shown = capfd.readouterr().err
    assert words in shown
    assert "Traceback" not in shown


def test_the_documented_table_has_exactly_the_cases_that_are_produced_here():
    table = DOCS.read_text(encoding="utf-8").split("| code | case |")[1]
    rows = re.findall(r"^\| (\d+) \| ([^|]+?) \|", table, flags=re.MULTILINE)
    assert sorted((int(code), what) for code, what in rows) == sorted(
        (code, what) for what, (code, _, _) in CASES.items()
    )


def test_a_night_without_an_identified_device_states_no_yield(tmp_path, monkeypatch, capfd):
    stub_runs(monkeypatch, stub_block("fit_failed", "no maximum"), page=True)
    assert call([*run_arguments(tmp_path), "--json"]) == 1
    answer = json.loads(capfd.readouterr().out)
    assert (answer["yield"], answer["yield_interval"]) == (None, None)
    assert answer["main_cause"] == "4 of 4 devices fit failed: no maximum"
    page = Path(answer["report"]).read_text(encoding="utf-8")
    assert "<title>No yield" in page
    assert "0.0 %" not in page.split("</header>")[0].split('class="counts"')[0].replace("\u00a0", " ")
    assert call(["query", "SELECT count(*) AS n FROM devices", "--results", str(tmp_path / "results")]) == 0


def test_an_interrupted_run_keeps_its_blocks_and_names_the_command_that_resumes_it(tmp_path, monkeypatch, capfd):
    def second(source: Any, at: Any) -> Any:
        return stub_block()(source, at) if at.index == 0 else _interrupted()

    stub_runs(monkeypatch, second)
    assert call(run_arguments(tmp_path)) == 130
    message = capfd.readouterr().err.strip().splitlines()[-1]
    assert message.startswith("interrupted; 2 of 4 devices are stored; next: gyroscreen run --resume ")
    stub_runs(monkeypatch)
    assert call(message.split("next: gyroscreen ")[1].split()) == 0
    assert read_run(tmp_path / "results").devices.num_rows == 4


def test_workers_do_not_receive_the_interrupt_of_the_terminal():
    sleeper = [sys.executable, "-c", "import time; print('up', flush=True); time.sleep(60)"]
    found: list[subprocess.Popen[str]] = []
    with deaf_children():
        start = threading.Thread(
            target=lambda: found.append(subprocess.Popen(sleeper, stdout=subprocess.PIPE, text=True))
        )
        start.start()
        start.join()
    process = found[0]
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.kill()
    process.wait()
    process.stdout.close()
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interrupt_that_a_callback_swallows_is_repeated(monkeypatch):
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    repeat_lost_interrupts()

    @ctypes.CFUNCTYPE(None)
    def callback() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0)

    def wait() -> None:
        callback()
        time.sleep(5.0)

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        wait()
    assert time.monotonic() - start < 4.0
