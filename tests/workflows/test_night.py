"""The night, end to end: same table whatever the workers, blocks or interruptions."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.store.digest import table_digest
from pipeline.store.read import read_run
from pipeline.store.run import open_run
from workflows.block import Block, virtual_block
from workflows.cli import call
from workflows.config import load_config

CONFIG = """
[run]
devices = {devices}
seed = 7
block = {block}
"""


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from workflows.cli import main; main()", *arguments]


def run(tmp: Path, name: str, devices: int = 8, block: int = 2, workers: int = 1) -> str:
    config = tmp / f"{name}.toml"
    config.write_text(CONFIG.format(devices=devices, block=block))
    done = subprocess.run(
        command("run", str(config), "--out", str(tmp / name), "--workers", str(workers), "--json"),
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["run_id"]


def digest(results: Path) -> str:
    return table_digest(read_run(results).devices)


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of eight devices with one worker, blocks of two."""
    tmp = tmp_path_factory.mktemp("night")
    run(tmp, "one")
    return tmp / "one"


def test_workers_and_blocks_do_not_change_the_table(night: Path, tmp_path: Path) -> None:
    run(tmp_path, "two", block=3, workers=2)
    assert digest(tmp_path / "two") == digest(night)


def test_a_run_killed_half_way_and_resumed_gives_the_same_table(night: Path, tmp_path: Path) -> None:
    config, results = tmp_path / "killed.toml", tmp_path / "killed"
    config.write_text(CONFIG.format(devices=8, block=1))
    process = subprocess.Popen(
        command("run", str(config), "--out", str(results), "--workers", "1"),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline:
        time.sleep(0.02)
        if list(results.glob("run=*/manifest.json")) and len(open_run(results).committed_blocks()) >= 3:
            break
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    committed = open_run(results).committed_blocks()
    assert 3 <= len(committed) < 8
    assert call(["run", "--resume", "latest", "--out", str(results), "--workers", "2", "--json"]) == 0
    assert digest(results) == digest(night)


def test_results_query_report_and_verify(night: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert call(["query", "SELECT count(*) AS n FROM devices", "--results", str(night), "--format", "json"]) == 0
    assert json.loads(capfd.readouterr().out) == [{"n": 8}]
    page = tmp_path / "page.html"
    assert call(["report", "--results", str(night), "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8").lower().startswith("<!doctype html>")
    assert call(["verify", "--results", str(night)]) == 0


def test_a_block_is_a_pure_function_of_configuration_and_device_numbers() -> None:
    config = load_config(None, {"seed": 7})
    whole = virtual_block(config, Block(0, 0, 3)).devices
    alone = virtual_block(config, Block(5, 2, 1)).devices
    assert whole.slice(2, 1).to_pylist() == alone.to_pylist()


def test_a_gate_that_the_user_set_fails_with_code_1_and_keeps_the_results(tmp_path: Path) -> None:
    config = tmp_path / "gate.toml"
    config.write_text(CONFIG.format(devices=2, block=2) + "[targets]\nyield_min = 1.0\n[limits.split_hz]\nmax = 0.001\n")
    results = tmp_path / "gate"
    assert call(["run", str(config), "--out", str(results), "--workers", "1", "--json"]) == 1
    assert read_run(results).devices.num_rows == 2
