"""A measured lot from what the user names: a lot.toml, a table, a run, or a folder of runs."""

from __future__ import annotations

from pathlib import Path

from pipeline.errors import MeasurementError, UsageError
from pipeline.learning.lot.lot_file import LotFile
from pipeline.learning.lot.table import LotTable, lot_of_table, read_lot, read_table
from pipeline.store.folders import PREFIX, run_folders
from pipeline.store.manifest import NAME as MANIFEST
from pipeline.store.read import read_run


def read_measured_lot(path: Path) -> LotTable:
    """The lot at ``path``.

    Parameters
    ----------
    path : a lot.toml or a folder with one, a run, a folder of runs (the newest), or a table of result quantities.

    Raises
    ------
    UsageError : nothing of the kind is there, or the run holds no device.
    ConfigError, MeasurementError : as :func:`pipeline.learning.lot.table.read_lot`.
    IntegrityError : a run is not what was committed.
    """
    if path.is_dir() and not (path / "lot.toml").is_file():
        folder, run = (path.parent, path.name.removeprefix(PREFIX)) if (path / MANIFEST).is_file() else (path, None)
        if not run_folders(folder):
            raise UsageError(
                "the folder holds no lot",
                value=str(path),
                allowed="lot.toml beside a table, a run, or a folder of runs",
                next_step="write lot.toml (docs/how-to/lots.md), or make a run with `gyroscreen run`",
            )
        tables = read_run(folder, run)
        if tables.devices.num_rows == 0:
            raise UsageError("the run holds no device", value=str(path), next_step="name another run")
        return lot_of_table(
            tables.devices, LotFile(file="devices", gyro=True), tables.manifest.run_id, f"run {tables.manifest.run_id}"
        )
    if path.suffix.lower() in (".parquet", ".csv"):
        return lot_of_table(read_table(path), LotFile(file=path.name, gyro=True), path.stem, path.name)
    if not path.exists():
        raise MeasurementError("there is no such lot", value=str(path), next_step="check the path")
    return read_lot(path)
