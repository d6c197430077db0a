"""Peak memory of a campaign of a night, by the size of its records, beside the bound that decides whether it is read.

    python -m tests.measure.campaign_memory [MB ..] [--band LOW_HZ HIGH_HZ]

A campaign has a second of silence and a chirp with so many MB of values (default 8, 32, 96); each is identified twice in a
process of its own, so that what a process keeps for the next device counts.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from pipeline.device.model import Model
from pipeline.experiment.campaign import write_campaign
from pipeline.experiment.excitation import Chirp, Silence
from pipeline.input_limits import MEMORY_BASE, MEMORY_COLUMNS, MEMORY_PER_BYTE
from workflows.config import load_config
from workflows.screening.campaign_block import campaign_block
from workflows.screening.plan import plan
from workflows.simulate import _measure, campaign_config, device_parameters

CONFIG = """[source]
kind = "campaigns"
path = "{folder}"
[diagnosis]
enabled = false
[identification]
low_hz = {low}
high_hz = {high}
"""


def peak_bytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def write(folder: Path, megabytes: float) -> None:
    """A campaign whose chirp has five columns with ``megabytes`` of values."""
    config = campaign_config(None)
    instrument = config.instrument.instrument()
    chirp = replace(Chirp(), duration_s=megabytes * 1e6 / 40.0 / instrument.sample_rate_hz)
    model = Model()
    values = {name: value for name, value in device_parameters({}, 1).items() if name in model.by_name}
    records = (("silence", "noise", Silence(2, 1.0)), ("chirp", "fit", chirp))
    write_campaign(
        _measure(config, model, values, config.hum_source(), 1e-3, records, instrument, 1), folder / "device"
    )


def measured(folder: Path, megabytes: float, low: float, high: float) -> str:
    write(folder, megabytes)
    (folder / "lot.toml").write_text(CONFIG.format(folder=folder, low=low, high=high))
    planned = plan(load_config(folder / "lot.toml", {}))
    started = time.process_time()
    for _ in range(2):
        row = campaign_block(planned.config, planned.blocks[0], planned.campaigns).devices.to_pylist()[0]
    bins = (high - low) * megabytes * 1e6 / 40.0 / 1e4
    bound = MEMORY_BASE + MEMORY_PER_BYTE * megabytes * 1e6 + MEMORY_COLUMNS * 16 * bins
    return (
        f"{megabytes:6.0f} MB of values, band {low:g} to {high:g} Hz: "
        f"peak {peak_bytes() / 1e6:5.0f} MB, bound {bound / 1e6:5.0f} MB, "
        f"{(time.process_time() - started) / 2.0:5.1f} s of processor time each, {row['status']} {row['status_reason'] or ''}"
    )


def main(arguments: list[str]) -> None:
    band = [400.0, 700.0]
    if "--band" in arguments:
        at = arguments.index("--band")
        band, arguments = [float(one) for one in arguments[at + 1 : at + 3]], arguments[:at]
    if arguments[:1] == ["one"]:
        with tempfile.TemporaryDirectory() as name:
            print(measured(Path(name), float(arguments[1]), *band), flush=True)
        return
    for megabytes in arguments or ["8", "32", "96"]:
        shown = ["--band", *map(str, band)]
        subprocess.run([sys.executable, "-m", __spec__.name, "one", megabytes, *shown], check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
