"""The screening run from the command to the report; its table does not depend on workers, blocks or interruptions."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline.experiment.campaign import write_campaign
from pipeline.store.digest import table_digest
from pipeline.store.files import sha256
from pipeline.store.read import find_run, read_run
from pipeline.store.run import open_run
from pipeline.store.stored_numbers import read_numbers
from tests.stub_runs import empty_pages
from workflows.cli import call
from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.simulate import campaign_config, simulate

CONFIG = """
[run]
devices = {devices}
seed = 7
block = {block}
[diagnosis]
sample = 1
"""


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from workflows.cli import main; main()", *arguments]


def run(tmp: Path, name: str, *options: str, devices: int = 8, block: int = 2) -> Path:
    """Folder with the results of a run with these options."""
    config = tmp / f"{name}.toml"
    config.write_text(CONFIG.format(devices=devices, block=block))
    assert call(["run", str(config), "--out", str(tmp / name), "--json", *options]) == 0
    return tmp / name


def digest(results: Path) -> str:
    """Of the devices and of the numbers that they were drawn with."""
    numbers = read_numbers(find_run(results), 10**9)
    return table_digest(read_run(results).devices) + sha256(
        repr((numbers.device_id, numbers.keys)).encode() + numbers.values.tobytes()
    )


@pytest.fixture(scope="module")
def on_cluster(tmp_path_factory: pytest.TempPathFactory, scheduler: str) -> Path:
    """Results of eight devices on an existing cluster with one worker, in blocks of two; ``report`` draws their page."""
    with pytest.MonkeyPatch.context() as patch:
        empty_pages(patch)
        return run(tmp_path_factory.mktemp("batch"), "remote", "--scheduler", scheduler)


# The first test: it compiles the kernels once, before several processes need them.
def test_a_block_is_a_pure_function_of_configuration_and_device_numbers() -> None:
    config = load_config(None, {"seed": 7})
    whole = virtual_block(config, DeviceBlock(0, 0, 3))
    alone = virtual_block(config, DeviceBlock(5, 2, 1))
    assert whole.devices.slice(2, 1).to_pylist() == alone.devices.to_pylist()
    numbers = alone.irregularities.num_rows
    assert numbers == 64
    assert whole.irregularities.slice(2 * numbers, numbers).to_pylist() == alone.irregularities.to_pylist()


@pytest.mark.usefixtures("without_page")
def test_two_local_workers_and_other_blocks_give_the_table_of_a_cluster(on_cluster: Path, tmp_path: Path) -> None:
    assert digest(run(tmp_path, "two", "--workers", "2", block=3)) == digest(on_cluster)


@pytest.mark.usefixtures("without_page")
def test_a_run_that_is_killed_and_resumed_gives_the_same_table(
    on_cluster: Path, scheduler: str, tmp_path: Path
) -> None:
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
    assert call(["run", "--resume", "latest", "--out", str(results), "--scheduler", scheduler, "--json"]) == 0
    assert digest(results) == digest(on_cluster)


def test_query_report_and_verify_read_the_results(
    on_cluster: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert call(["query", "SELECT count(*) AS n FROM devices", "--results", str(on_cluster), "--format", "json"]) == 0
    assert json.loads(capfd.readouterr().out) == [{"n": 8}]
    page = tmp_path / "page.html"
    assert call(["report", "--results", str(on_cluster), "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8").lower().startswith("<!doctype html>")
    assert call(["verify", "--results", str(on_cluster)]) == 0


def test_a_query_from_the_shell_prints_only_its_result(on_cluster: Path) -> None:
    query = command("query", "SELECT count(*) AS n FROM devices", "--results", str(on_cluster), "--format", "json")
    done = subprocess.run(query, capture_output=True, text=True, check=False)
    assert (done.returncode, json.loads(done.stdout), done.stderr) == (0, [{"n": 8}], "")


@pytest.mark.usefixtures("without_page", "brief_records")
def test_measured_campaigns_are_identified_and_an_unreadable_one_is_a_row(scheduler: str, tmp_path: Path) -> None:
    for seed in (1, 2):
        simulated = simulate(campaign_config(None), {}, ["offdiagonal_damping:c12=0.5"], seed)
        write_campaign(simulated.campaign, tmp_path / "lot" / f"device-{seed}")
    (tmp_path / "lot" / "broken").mkdir()
    (tmp_path / "lot" / "broken" / "campaign.toml").write_text("nothing = true\n")
    with (tmp_path / "lot" / "device-1" / "campaign.toml").open("a") as file:
        file.write("\n[reference]\nf3_hz = [590.0, 50.0]\n")
    config = tmp_path / "lot.toml"
    config.write_text(f'[source]\nkind = "campaigns"\npath = "{tmp_path / "lot"}"\n[diagnosis]\nsample = 1\n')
    assert call(["run", str(config), "--out", str(tmp_path / "out"), "--scheduler", scheduler, "--json"]) == 0
    rows = {row["device_id"]: row for row in read_run(tmp_path / "out").devices.to_pylist()}
    assert rows["virtual-1"]["status"] == rows["virtual-2"]["status"] == "ok"
    assert rows["virtual-1"]["c12_per_s"] == pytest.approx(0.5, abs=5e-4)
    assert rows["virtual-1"]["reference"].startswith("f3_hz z=")
    assert rows["broken"]["status"] == "fit_failed"
    assert "nothing" in rows["broken"]["status_reason"]


@pytest.mark.usefixtures("without_page")
def test_a_yield_below_the_target_has_exit_code_1_and_keeps_the_results(scheduler: str, tmp_path: Path) -> None:
    config = tmp_path / "gate.toml"
    config.write_text(
        CONFIG.format(devices=2, block=2) + "[targets]\nyield_min = 1.0\n[limits.split_hz]\nmax = 0.001\n"
    )
    results = tmp_path / "gate"
    assert call(["run", str(config), "--out", str(results), "--scheduler", scheduler, "--json"]) == 1
    assert read_run(results).devices.num_rows == 2
