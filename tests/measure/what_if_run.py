"""A what-if of a run, against a new run of the changed population: devices identified, verdicts of both.

    python tests/measure/what_if_run.py FOLDER [--devices 1000] [--what-if damping_anisotropy.die*0.5]

Two runs of the shipped population with 100 lots below FOLDER; one that is complete is not repeated, one that stopped is resumed.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np

from pipeline.store.columns import StoredRun, with_run
from pipeline.store.read import find_run, list_runs
from reports.attribution.reweighting import paired_share
from reports.devices import Devices
from reports.interval_estimate import IntervalEstimate
from workflows.attribution.what_if import parsed_changes, what_if
from workflows.config import load_config
from workflows.screening.settings import population

LOTS = ("lots_per_batch = 5", "lots_per_batch = 100")


def prepared(folder: Path, name: str, devices: int, values: dict[str, float], seed: int) -> Path:
    """The results of a run, made or resumed."""
    spec = population(load_config(None)).with_values(values).to_toml()
    if LOTS[0] not in spec:
        raise SystemExit("the shipped population has other lots")
    (folder / f"{name}.spec.toml").write_text(spec.replace(*LOTS), encoding="utf-8")
    config = folder / f"{name}.toml"
    config.write_text(
        f'[run]\ndevices = {devices}\nseed = {seed}\n[source]\nspec = "{name}.spec.toml"\n[diagnosis]\nenabled = false\n',
        encoding="utf-8",
    )
    results = folder / name
    runs = list_runs(results)
    if not runs or runs[-1].status != "complete":
        more = ["--resume", "latest"] if runs else []
        command = [
            sys.executable,
            "-c",
            "from workflows.cli import main; main()",
            "run",
            str(config),
            "--out",
            str(results),
        ]
        subprocess.run([*command, *more], check=True)
    return results


def not_passed(tables: StoredRun) -> IntervalEstimate:
    """Share of the devices that do not pass, with lots as draws."""
    columns = Devices(tables.devices)
    lost = (~columns.has("pass")).astype(float)
    return paired_share(lost, lost, columns.text("lot").codes).before


def main() -> None:
    """Print the what-if, the new run, and their difference over its sd."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--devices", type=int, default=1000)
    parser.add_argument("--what-if", default="damping_anisotropy.die*0.5")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    changes = parsed_changes(population(load_config(None)), given.what_if)
    before = prepared(given.folder, "present", given.devices, {}, 1)
    slug = "".join(c if c.isalnum() else "-" for c in given.what_if)
    new = prepared(given.folder, slug, given.devices, {name: value for name, (_, value) in changes.items()}, 2)
    config = load_config(given.folder / "present.toml")
    found = with_run(before, None, lambda t: what_if(config, find_run(before), t.devices, given.what_if))
    run = with_run(new, None, not_passed)
    print(json.dumps({"new run": [run.value, run.sd], "refusal": found.refusal}))
    shares = {"truth, drawn again": found.truth, **(found.reweighted or {})}
    for name, one in shares.items():
        z = (one.after.value - run.value) / math.hypot(one.after.sd, run.sd)
        ends = np.round([one.before.value, one.after.value, one.after.low, one.after.high, one.lots_with_loss, z], 4)
        print(name, dict(zip(("before", "after", "low", "high", "lots", "z against the new run"), ends.tolist())))


if __name__ == "__main__":
    main()
