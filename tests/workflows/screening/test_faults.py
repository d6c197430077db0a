"""A device that ends its worker costs its own row: stub devices with faults on demand, and the rules without processes."""

import asyncio
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed.utils import LoopRunner, sync
from tornado.ioloop import IOLoop

from pipeline.errors import IncompleteError
from tests.dask_processes import scheduler_and_worker
from workflows.screening import dispatch, local_workers
from workflows.screening.cluster import cluster
from workflows.screening.dispatch import _Dispatch, guarded_in_parallel
from workflows.screening.faults import Ending, Faults, Sign, TimeLimit, Try, after_exception, after_loss
from workflows.screening.heartbeats import Heartbeats
from workflows.screening.scheduler import Scheduler
from workflows.studies.commit_cost import commits
from workflows.studies.fault_kinds import faulty_numbers

NUMBERS: Faults[range] = Faults(devices=lambda item: item, part=lambda _, devices: devices, lost=lambda item, why: item)


def test_a_crash_5_gb_a_loop_in_compiled_code_and_a_defect_cost_only_their_devices(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("workflows.screening.cluster.WORKER_BYTES", 2**29)  # a busy machine fills 2 GiB in 6 s
    lost: dict[int, str] = {}

    def given_up(item: range, why: str) -> range:
        lost[item.start] = why
        return range(0)

    faults = {1: "segfault", 4: "allocate", 8: "loop", 10: "raise"}
    rules = replace(NUMBERS, lost=given_up)
    with cluster(2, None) as client:
        items = [range(6), range(6, 12)]
        found = [n for _, part in guarded_in_parallel(client, faulty_numbers, faults, items, rules, 2.0) for n in part]
    assert sorted(found) == [n * n for n in range(12) if n not in faults]
    assert set(lost) == set(faults)
    assert "SIGSEGV" in lost[1]
    assert "more memory than the 0.5 GiB" in lost[4]
    assert "time limit" in lost[8]
    assert "KeyError" in lost[10]


@pytest.mark.parametrize(("silent_s", "stopped_looks"), [(2.0, 10**6), (60.0, 5)])
def test_a_worker_that_is_stopped_is_replaced(
    silent_s: float, stopped_looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its silence, as on another machine, and by the state of its process."""
    monkeypatch.setattr(dispatch, "_SILENT_S", silent_s)
    monkeypatch.setattr(local_workers, "_STOPPED_LOOKS", stopped_looks)
    monkeypatch.setattr(dispatch, "_LOOK_S", 0.5)
    with cluster(1, None) as client:
        items = [range(2), range(2, 4)]
        started = guarded_in_parallel(client, faulty_numbers, {1: "slow", 3: "slow"}, items, NUMBERS)
        found = [next(started)]
        for process in psutil.Process().children():
            process.suspend()
        found += started
    assert sorted(n for _, part in found for n in part) == [0, 1, 4, 9]


def test_a_driver_that_was_suspended_does_not_take_its_workers_for_silent() -> None:
    heartbeats = Heartbeats(looked=0.0)
    heartbeats.look({"a": 7.0, "b": 7.0}, 2.0)
    for now in range(4, 62, 2):
        heartbeats.look({"a": 7.0, "b": 7.0 + now}, float(now))
    assert heartbeats.silent(50.0) == ["a"]
    heartbeats.look({"a": 8.0, "b": 67.0}, 62.0)
    heartbeats.look({"a": 8.0, "b": 67.0}, 36_000.0)
    assert heartbeats.silent(50.0) == []


def _work_without(scheduler: subprocess.Popen[bytes], address: str) -> None:
    """Work on ``scheduler``, which is killed after the first result."""
    numbers, slow = [range(n, n + 1) for n in range(40)], dict.fromkeys(range(40), "slow")
    with cluster(0, Scheduler(address)) as client:
        client.wait_for_workers(1, timeout=60)
        for _ in guarded_in_parallel(client, faulty_numbers, slow, numbers, NUMBERS, None, 1.0):
            scheduler.kill()


def test_a_scheduler_that_is_lost_ends_the_run_with_one_message(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dispatch, "_LOOK_S", 0.2)
    with (
        scheduler_and_worker() as (address, scheduler),
        pytest.raises(IncompleteError, match=r"scheduler is lost.*--resume"),
    ):
        _work_without(scheduler, address)
    captured = capfd.readouterr()
    assert captured.out + captured.err == ""


@dataclass(frozen=True)
class Span:
    first: int
    count: int
    lost: str = ""


SPANS: Faults[Span] = Faults(
    devices=lambda span: range(span.first, span.first + span.count),
    part=lambda span, devices: replace(span, first=devices.start, count=len(devices)),
    lost=lambda span, reason: replace(span, lost=reason),
)


def until_done(span: Span, bad: int, seen: bool) -> tuple[set[int], int, int]:
    """Devices that were lost, losses of workers, and devices computed, where device ``bad`` always ends its worker."""
    left, lost, losses, computed = [Try(span)], set(), 0, 0
    while left:
        tried = left.pop()
        devices = SPANS.devices(tried.item)
        if tried.item.lost:
            lost |= set(devices)
        elif bad in devices:
            losses, computed = losses + 1, computed + bad - devices.start
            sign = Sign("", bad, 60.0, 0.0) if seen else None
            left += after_loss(replace(tried, unstarted=9), sign, 1.0, Ending(), SPANS)
        else:
            computed += len(devices)
    return lost, losses, computed


@pytest.mark.parametrize("bad", range(25))
def test_a_block_is_divided_down_to_the_device_that_ends_its_worker(bad: int) -> None:
    lost, losses, computed = until_done(Span(0, 25), bad, seen=True)
    assert (lost, losses) == ({bad}, 4)  # twice the block, twice the device
    assert computed <= 24 + 2 * bad
    lost, losses, _ = until_done(Span(0, 25), bad, seen=False)
    assert lost == {bad}
    assert losses <= 2 + 5 + 2  # log2(25) divisions


def test_a_worker_that_ends_once_costs_no_device_and_a_queued_item_is_innocent() -> None:
    whole = Span(0, 25)
    assert after_loss(Try(whole), Sign("", 3, 60.0, 0.0), 1.0, Ending(), SPANS) == [Try(whole, 1)]
    assert after_loss(Try(whole, 1), None, 1.0, Ending(), SPANS) == [Try(whole, 1, 1)]
    # Memory that ran out says nothing about the time of the device, however late the driver learns of it.
    memory = Ending("more memory than a worker has", certain=True)
    assert after_loss(Try(whole), Sign("", 3, 60.0, 0.0), 99.0, memory, SPANS) == [Try(whole, 1)]


def test_the_device_that_exceeds_its_limit_is_lost_at_once() -> None:
    parts = [one.item for one in after_loss(Try(Span(0, 9)), Sign("", 4, 60.0, 0.0), 61.0, Ending(), SPANS)]
    assert [(part.first, part.count, bool(part.lost)) for part in parts] == [(0, 4, False), (4, 1, True), (5, 4, False)]
    assert after_exception(Try(Span(4, 1)), KeyError("x"), SPANS)[0].item.lost == "internal error: KeyError: 'x'"


def test_the_limit_is_20_medians_and_at_least_a_minute() -> None:
    limit = TimeLimit()
    assert limit.now_s == 600.0
    limit.seconds.extend([0.1, 0.2, 500.0])
    assert limit.now_s == 60.0
    limit.seconds.extend([7.0, 8.0])
    assert limit.now_s == pytest.approx(140.0)
    assert TimeLimit(5.0).now_s == 5.0


def test_the_cost_of_commits_is_measured_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workflows.studies.commit_cost.rendered_report", lambda *_: "")
    assert commits(10, tmp_path)["files"] == 12
    assert len((tmp_path / "commits.jsonl").read_text().splitlines()) == 1


class _WaitCancelledOnce:
    """A finished future; the first wait for its result is cancelled, as distributed does at a time limit under load."""

    status = "finished"

    def __init__(self, loop: IOLoop) -> None:
        self._loop, self._waits = loop, 0

    def result(self, timeout: float) -> str:
        self._waits += 1
        return sync(self._loop, self._answer, callback_timeout=timeout)

    async def _answer(self) -> str:
        if self._waits == 1:
            raise asyncio.CancelledError
        return "result"


def test_a_wait_that_distributed_cancels_does_not_end_a_run() -> None:
    runner = LoopRunner()
    runner.start()
    try:
        assert _Dispatch._gathered(None, _WaitCancelledOnce(runner.loop)) == "result"
    finally:
        runner.stop()


def test_items_that_the_scheduler_never_sends_are_submitted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatch, "_SILENT_S", 1.5)
    monkeypatch.setattr(dispatch, "_LOOK_S", 0.2)
    with cluster(1, None) as client:
        submit, nowhere = client.submit, ["tcp://127.0.0.1:9"]
        submitted: list[Any] = []

        def lost_at_first(*arguments: Any, **options: Any) -> Any:
            submitted.append(options["key"])
            return submit(*arguments, **options, **({"workers": nowhere} if len(submitted) <= 3 else {}))

        monkeypatch.setattr(client, "submit", lost_at_first)
        items = [range(2), range(2, 4), range(4, 6)]
        found = [n for _, part in guarded_in_parallel(client, faulty_numbers, {}, items, NUMBERS, 5.0) for n in part]
    assert sorted(found) == [n * n for n in range(6)]
    assert len(submitted) == 6
