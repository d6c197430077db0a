"""A device that ends its worker costs its own row: stub devices with faults on demand, and the rules without processes."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from pipeline.store.run import RunStore, create_run
from workflows.config import load_config
from workflows.screening.batch import run_blocks
from workflows.screening.faults import Faults, Sign, TimeLimit, Try, after_exception, after_loss
from workflows.screening.plan import RunPlan, plan
from workflows.studies.faults import Stub


def stub_run(tmp: Path, devices: int, block: int, limit_s: float = 2.0) -> tuple[RunPlan, RunStore]:
    """The plan and the folder of a run of stubs, without examination."""
    config = tmp / "stub.toml"
    config.write_text(
        f"[run]\ndevices = {devices}\nblock = {block}\ndevice_limit_s = {limit_s}\n[diagnosis]\nenabled = false\n"
    )
    return plan(load_config(config)), create_run(tmp / "out", "stub", "", {})


def lost_rows(store: RunStore, devices: int) -> dict[int, str]:
    """Reason by number of the devices that were lost; all others are there once and ok."""
    rows = store.devices().select(["device_id", "status", "status_reason"]).to_pylist()
    assert [row["device_id"] for row in rows] == [f"stub-{n:08d}" for n in range(devices)]
    assert {row["status"] for row in rows} <= {"ok", "lost"}
    return {int(row["device_id"][5:]): row["status_reason"] for row in rows if row["status"] == "lost"}


def test_a_crash_a_loop_in_compiled_code_and_a_defect_cost_the_rows_of_their_devices(tmp_path: Path) -> None:
    planned, store = stub_run(tmp_path, 12, 6)
    run_blocks(planned, store, 2, None, True, Stub(0.0, {1: "segfault", 8: "loop", 10: "raise"}))
    lost = lost_rows(store, 12)
    assert set(lost) == {1, 8, 10}
    assert "SIGSEGV" in lost[1]
    assert "time limit" in lost[8]
    assert "KeyError" in lost[10]


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
            left += after_loss(replace(tried, unstarted=9), sign, 1.0, False, "", SPANS)
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
    assert after_loss(Try(whole), Sign("", 3, 60.0, 0.0), 1.0, False, "", SPANS) == [Try(whole, 1)]
    assert after_loss(Try(whole, 1), None, 1.0, False, "", SPANS) == [Try(whole, 1, 1)]
    # A worker that the driver ended because it did not respond says nothing about the time of the device.
    assert after_loss(Try(whole), Sign("", 3, 60.0, 0.0), 99.0, True, "", SPANS) == [Try(whole, 1)]


def test_the_device_that_exceeds_its_limit_is_lost_at_once() -> None:
    parts = [one.item for one in after_loss(Try(Span(0, 9)), Sign("", 4, 60.0, 0.0), 61.0, False, "", SPANS)]
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
