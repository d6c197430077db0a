"""Processor time of ``gyroscreen report --limits`` on runs of stub devices with 100 stored draws each; the least of three.

usage: python -m tests.measure.what_if_time [--common] [DEVICES ..]; the default is 10,000 and 100,000 (1.1 GB, made in half a
minute).  --common: with the common errors of docs/explanation/uncertainty.md.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import tomli_w

from pipeline.experiment.files.common_tables import SystematicTable
from pipeline.store.run import create_run
from tests.measure.report_time import seconds_of
from workflows.config import RunConfig, to_toml_table
from workflows.screening.block import DeviceBlock
from workflows.screening.guard import unguarded
from workflows.screening.parts import BlockItem
from workflows.screening.plan import without_none
from workflows.studies.scaling.stub import StubRows

ROWS = 250
LIMITS = """
[limits]
f1_hz = { min = 524.79, max = 546.21 }
f2_hz = { min = 524.79, max = 546.21 }
split_hz = { max = 2.5 }
quality1 = { min = 1200.0 }
quality2 = { min = 1200.0 }
quadrature_rate_dps = { min = -600.0, max = 600.0 }
rate_bias_dps = { min = -30.0, max = 30.0 }
"""


def stub_run(folder: Path, devices: int, common: SystematicTable | None = None) -> None:
    """A run "r" of stub devices with 100 stored draws each, in whole blocks."""
    config = RunConfig(systematic=common or SystematicTable())
    store = create_run(folder, "r", tomli_w.dumps(without_none(to_toml_table(config))), {"seed": 0})
    for block in range(devices // ROWS):
        tables = StubRows()(config, BlockItem(DeviceBlock(block, block * ROWS, ROWS)), unguarded)
        store.commit_block(block, tables.devices, tables.posterior)
    store.finish("complete", {})


def main() -> None:
    """Make each run, judge it again, print the least time."""
    numbers = [text for text in sys.argv[1:] if text != "--common"]
    common = SystematicTable(0.5, 0.007, 0.01, 5.0, 0.5) if "--common" in sys.argv else SystematicTable()
    for devices in [int(text) for text in numbers] or [10_000, 100_000]:
        with tempfile.TemporaryDirectory(prefix="gyroscreen-what-if-") as folder:
            stub_run(Path(folder), devices, common)
            limits = Path(folder) / "new.toml"
            limits.write_text(LIMITS, encoding="utf-8")
            command = [sys.executable, "-m", "workflows.cli", "report", "--results", folder, "--limits", str(limits)]
            least = min(seconds_of([*command, "--out", str(Path(folder) / "page.html")])[0] for _ in range(3))
            print(f"{devices // ROWS * ROWS} devices: {least:.1f} s of processor time", flush=True)


if __name__ == "__main__":
    main()
