"""Runs whose virtual devices are judged by their true values: all tables of a run in seconds, without identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import tomli_w

from pipeline.store.run import create_run
from pipeline.store.schema import devices_table
from populations.draw import draw
from reports.decision import conforms
from workflows.config import RunConfig, load_config, to_toml_table
from workflows.screening.block import truth_columns
from workflows.screening.drawn_table import drawn_table
from workflows.screening.plan import without_none
from workflows.screening.settings import population, spec_text

#: Sixty lots in few devices: the shipped population has five at a time.
MANY_LOTS = ("lots_per_batch = 5", "lots_per_batch = 60")


def judged_config(folder: Path, devices: int, more: str = "", seed: int = 1) -> RunConfig:
    """A run of the shipped population with sixty lots."""
    text = spec_text(load_config(None).source).replace(*MANY_LOTS)
    assert MANY_LOTS[1] in text
    (folder / "many.toml").write_text(text, encoding="utf-8")
    (folder / "run.toml").write_text(
        f'[run]\ndevices = {devices}\nseed = {seed}\n[source]\nspec = "many.toml"\n{more}', encoding="utf-8"
    )
    return load_config(folder / "run.toml")


def judged_run(results: Path, config: RunConfig, stored: bool = True, block: int = 600, first_stored: int = 0) -> None:
    """Write the run "r" below ``results``: verdicts of the true values, estimates equal to them, stored irregularities."""
    store = create_run(results, "r", tomli_w.dumps(without_none(to_toml_table(config))), {"seed": config.run.seed})
    for number, first in enumerate(range(0, config.run.devices, block)):
        devices, numbers = _block(config, first, min(block, config.run.devices - first))
        store.commit_block(number, devices, None, numbers if stored and number >= first_stored else None)
    store.finish("complete", {})


def _block(config: RunConfig, first: int, count: int) -> tuple[pa.Table, pa.Table]:
    spec, limits = population(config), config.judged_by()
    drawn = draw(spec, config.run.seed, first, count)
    truth = truth_columns(config, drawn, float(spec.angular_gain))
    met = conforms(limits, {q: truth[f"true_{q}"] for q in limits.quantities})
    columns = {
        "device_id": list(drawn.device_id),
        "lot": list(drawn.lot),
        "wafer": list(drawn.wafer),
        "die_x_mm": drawn.die_x_mm,
        "die_y_mm": drawn.die_y_mm,
        "status": ["ok"] * count,
        "verdict": np.where(met, "pass", "fail").tolist(),
        **{q: truth[f"true_{q}"] for q in limits.quantities},
        **truth,
    }
    return devices_table(columns), drawn_table(drawn)
