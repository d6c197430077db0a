"""A virtual measured lot: devices of a population, measured with a stated noise, as a table with its lot.toml."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError, unwritable
from pipeline.learning.lot.gyro import NEEDED
from populations.draw import Draw, draw
from populations.irregularity import find
from populations.spec import PopulationSpec, spec_from_toml

from .population import trial_values

#: sd of the measurement of each quantity, about ten times that of the shipped experiment at a split of 2 Hz.
NOISE: Mapping[str, float] = {
    "theta_deg": 0.01, "split_hz": 1e-3, "f1_hz": 1e-3, "f2_hz": 1e-3, "f3_hz": 3e-3, "zeta1": 1e-6, "zeta2": 1e-6,
    "zeta3": 3e-6, "c12_per_s": 3e-3, "rocking_gain": 13e-3, "updown_gain": 28e-3, "sense_imbalance": 5e-4,
    "drive_imbalance": 5e-4,
}  # fmt: skip
#: Devices of each wafer.
DIES = 40


def measured_values(made: Draw, generator: np.random.Generator) -> dict[str, FloatArray]:
    """Measured quantities (B,) of drawn devices: the truth with ``NOISE``."""
    return {name: made.true[name] + NOISE[name] * generator.standard_normal(len(made.index)) for name in NEEDED}


def with_irregularities(
    spec: PopulationSpec, texts: Sequence[str]
) -> tuple[PopulationSpec, dict[str, dict[str, float]]]:
    """The population with "NAME" or "NAME:param=value,..", and all parameters of each as they were set.

    Parameters that are neither given nor in the file have a trial size.

    Raises
    ------
    UsageError : a text that is not of this form, or an unknown irregularity.
    ConfigError : an unknown parameter, or a value out of range.
    """
    tables = {name: dict(values) for name, values in spec.irregularity.items()}
    known = find(spec.irregularity_folders)
    truth: dict[str, dict[str, float]] = {}
    for text in texts:
        name, _, rest = text.partition(":")
        if name not in known:
            raise UsageError(
                "no such irregularity", value=name, allowed=", ".join(known), next_step="correct --irregularity"
            )
        given: dict[str, float] = {}
        for item in filter(None, rest.split(",")):
            key, equals, value = item.partition("=")
            try:
                given[key.strip()] = float(value)
            except ValueError:
                equals = ""
            if not equals:
                raise UsageError(
                    "--irregularity has a part that is no assignment",
                    value=item,
                    allowed="NAME or NAME:param=value,param=value",
                    next_step="correct it",
                )
        tables[name] = truth[name] = {**trial_values(spec, name), **tables.get(name, {}), **given}
    changed = msgspec.structs.replace(spec, irregularity=tables)
    # Read back, because only a file that is read is checked.
    return spec_from_toml(changed.to_toml(), "--irregularity"), truth


def simulate_lot(
    out: Path, spec: PopulationSpec, irregularities: Sequence[str], seed: int, dies: int = DIES
) -> tuple[int, int]:
    """Write lot.parquet, lot.toml, the given population and truth.json to ``out``; returns devices and wafers.

    Raises
    ------
    UsageError : the folder cannot be written; as :func:`with_irregularities`.
    ConfigError : as :func:`with_irregularities`.
    """
    made_of, truth = with_irregularities(spec, irregularities)
    wafers = spec.wafer.lots_per_batch * spec.wafer.wafers_per_lot
    made = draw(made_of, seed, 0, wafers * dies)
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(118,))))
    values = measured_values(made, generator)
    columns: dict[str, Any] = {
        "device_id": list(made.device_id),
        "lot": list(made.lot),
        "wafer": list(made.wafer),
        "die_x_mm": made.die_x_mm,
        "die_y_mm": made.die_y_mm,
    }
    for name in NEEDED:
        columns[name] = values[name]
        columns[f"{name}_sd"] = np.full(len(made.index), NOISE[name])
    radius = spec.wafer.diameter_mm / 2.0
    text = f'file = "lot.parquet"\ngyro = true\nname = "{out.name}"\n\n[wafer]\nradius_mm = {radius!r}\n'
    try:
        out.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns), out / "lot.parquet", write_page_checksum=True)
        (out / "lot.toml").write_text(text, encoding="utf-8")
        (out / "population.toml").write_text(spec.to_toml(), encoding="utf-8")
        found = {"seed": seed, "irregularities": truth}
        (out / "truth.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise unwritable("the lot", out, error) from None
    return len(made.index), wafers
