"""Read a measured lot from a table: lot.toml (``lot_file``) says which columns there are.

Shapes: n devices, q quantities.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from ...arrays import BoolArray, FloatArray
from ...errors import ConfigError, MeasurementError
from ...input_limits import check_path
from ...toml_files import check_known, load
from .gyro import COORDINATES, NEEDED, UNITS, coordinates, propagated
from .lot_file import LotFile, LotHold, LotQuantity
from .measured import MeasuredLot, hold_out

#: Largest table: 2 GB of float64.
VALUES = 2**28


@dataclass(frozen=True, eq=False)
class LotTable:
    """A measured lot, and what else lot.toml says.

    Parameters
    ----------
    lot : with the wafers that are held out.
    gyro, stage : whether its quantities are the coordinates of a gyro, and which stage of a population it shows.
    limits : quantity -> (min, max), in the coordinates of ``lot``; empty for a gyro.
    left_out : rows of the table that no status "ok" and no finite value has.
    """

    lot: MeasuredLot
    gyro: bool
    stage: Literal["package", "probe"]
    limits: Mapping[str, tuple[float, float]]
    left_out: int = 0

    def conforms(self, values: FloatArray) -> BoolArray:
        """(..) whether values (.., q) keep all limits of the table."""
        keep = np.ones(values.shape[:-1], dtype=np.bool_)
        for name, (low, high) in self.limits.items():
            own = values[..., self.lot.quantities.index(name)]
            keep &= (own >= low) & (own <= high)
        return keep


def read_lot(path: Path) -> LotTable:
    """The lot of a lot.toml, or of a folder that holds one.

    Raises
    ------
    ConfigError : lot.toml cannot be read, or has a wrong key or value.
    MeasurementError : the table cannot be read, lacks a column, or holds no device.
    """
    file = path / "lot.toml" if path.is_dir() else path
    found = load(file, LotFile, "lot.toml", "write one (docs/how-to/lots.md)")
    if found.gyro == bool(found.quantity):
        raise ConfigError(
            f"{file.name}: the quantities are not given once",
            value={"gyro": found.gyro, "quantity": sorted(found.quantity)},
            allowed="gyro = true, or [quantity.NAME] tables",
            next_step="write one of them",
        )
    table = read_table(file.parent / found.file)
    return lot_of_table(table, found, found.name or file.resolve().parent.name, file.name)


def read_table(path: Path) -> pa.Table:
    """A Parquet or CSV table.

    Raises
    ------
    MeasurementError : it cannot be read.
    """
    check_path(path, "a table", MeasurementError)
    if path.suffix.lower() not in (".parquet", ".csv"):
        raise MeasurementError(
            "a lot is read from Parquet or CSV",
            value=path.name,
            allowed=".parquet, .csv",
            next_step="convert the table",
        )
    try:
        if path.suffix.lower() == ".parquet":
            with pq.ParquetFile(path, page_checksum_verification=True, memory_map=False) as file:
                _allow(file.metadata.num_rows * file.metadata.num_columns, path)
                return file.read()
        _allow(path.stat().st_size // 4, path)
        return pa_csv.read_csv(path)
    except (OSError, pa.ArrowException, ValueError, KeyError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error).splitlines()[0]
        raise MeasurementError(
            f"the table cannot be read: {reason.lower()[:120]}",
            value=str(path),
            next_step="check the path and the file",
        ) from error


def _allow(values: int, path: Path) -> None:
    if values > VALUES:
        raise MeasurementError(
            "the table is too large", value=f"{path.name}: {values} values", allowed=f"{VALUES}", next_step="split it"
        )


def lot_of_table(table: pa.Table, found: LotFile, name: str, where: str) -> LotTable:
    """The lot in a table; ``where`` names lot.toml in messages.  Raises as :func:`read_lot`."""
    keep = np.ones(table.num_rows, dtype=np.bool_)
    if found.gyro and "status" in table.column_names:
        keep &= np.array(table["status"].to_pylist()) == "ok"
    if found.gyro:
        quantities: tuple[str, ...] = COORDINATES
        units: tuple[str, ...] = UNITS
        values, covariance = _gyro_values(table, found, where)
    else:
        quantities, units = tuple(found.quantity), tuple(q.unit for q in found.quantity.values())
        values, covariance = _plain_values(table, found.quantity, where)
        _varying(values, found.quantity, where)
    keep &= np.any(np.isfinite(values), axis=1)
    known = np.any(np.isfinite(values[keep]), axis=0) if np.any(keep) else np.ones(len(quantities), dtype=np.bool_)
    if found.gyro and np.any(keep):
        known &= np.nanmax(np.where(known, values[keep], 0.0), axis=0) > np.nanmin(
            np.where(known, values[keep], 0.0), axis=0
        )
    chosen = np.flatnonzero(known)
    x, y, time = (
        _numbers(table, getattr(found.columns, role), where, needed=False) for role in ("x_mm", "y_mm", "time")
    )
    radius = found.wafer.radius_mm or float(np.nanmax(np.hypot(x, y), initial=0.0)) or 1.0
    labels = {
        level: tuple(str(one) for one in table[column].to_pylist())
        for level in ("lot", "wafer", "package", "tester")
        if (column := getattr(found.columns, level)) in table.column_names
    }
    device_column = found.columns.device
    device = (
        tuple(str(one) for one in table[device_column].to_pylist())
        if device_column in table.column_names
        else tuple(f"row {k + 1}" for k in range(table.num_rows))
    )
    whole = MeasuredLot(
        name=name,
        quantities=tuple(quantities[k] for k in chosen),
        units=tuple(units[k] for k in chosen),
        values=values[:, chosen],
        covariance=covariance[:, chosen][:, :, chosen],
        labels=labels,
        x_mm=x,
        y_mm=y,
        radius_mm=radius,
        time=time,
        device=device,
    )
    lot = _held(whole.subset(keep), found.hold, where)
    return LotTable(lot, found.gyro, found.stage, _limits(found, lot, where), int((~keep).sum()))


def _held(lot: MeasuredLot, hold: LotHold, where: str) -> MeasuredLot:
    if hold.wafers is None:
        return hold_out(lot, hold.share) if hold.share > 0.0 else lot
    for wafer in hold.wafers:
        check_known(wafer, sorted(set(lot.wafers)), f"{where}: [hold] wafers", "wafer")
    if set(hold.wafers) >= set(lot.wafers):
        raise ConfigError(
            f"{where}: [hold] leaves no wafer for the fit", value=len(hold.wafers), next_step="hold fewer wafers"
        )
    return replace(lot, held=hold.wafers)


def _limits(found: LotFile, lot: MeasuredLot, where: str) -> dict[str, tuple[float, float]]:
    limits: dict[str, tuple[float, float]] = {}
    for name, bounds in found.limits.items():
        check_known(name, found.quantity, f"{where}: [limits]", "quantity")
        ends = [-np.inf if bounds.min is None else bounds.min, np.inf if bounds.max is None else bounds.max]
        if ends[0] > ends[1]:
            raise ConfigError(f"{where}: [limits.{name}] min is above max", value=ends, next_step="exchange them")
        if found.quantity[name].transform == "log":
            ends = [float(np.log(end)) if end > 0.0 else -np.inf for end in ends]
        if name in lot.quantities:
            limits[name] = (ends[0], ends[1])
    return limits


def _plain_values(table: pa.Table, quantities: Mapping[str, LotQuantity], where: str) -> tuple[FloatArray, FloatArray]:
    values: list[FloatArray] = []
    variances: list[FloatArray] = []
    for name, one in quantities.items():
        own = one.scale * _numbers(table, one.column or name, where)
        sd = np.zeros(len(own))
        if isinstance(one.sd, str):
            sd = abs(one.scale) * _numbers(table, one.sd, where)
        elif one.sd is not None:
            sd = np.full(len(own), abs(one.scale) * one.sd)
        if np.any(sd < 0.0):
            raise MeasurementError(
                f"{where}: [quantity.{name}] sd is negative", value=float(sd.min()), next_step="correct the table"
            )
        if one.transform == "log":
            if np.any(own <= 0.0):
                raise MeasurementError(
                    f"{where}: [quantity.{name}] is not positive and has no logarithm",
                    value=float(np.nanmin(own)),
                    allowed="above 0",
                    next_step='transform = "linear", or correct the table',
                )
            sd, own = sd / own, np.log(own)
        values.append(own)
        variances.append(np.nan_to_num(sd) ** 2)
    stacked = np.stack(variances, axis=-1)
    return np.stack(values, axis=-1), stacked[..., None] * np.eye(len(values))


def _varying(values: FloatArray, quantities: Mapping[str, LotQuantity], where: str) -> None:
    for k, name in enumerate(quantities):
        own = values[np.isfinite(values[:, k]), k]
        if own.size and np.ptp(own) == 0.0:
            raise MeasurementError(
                f"{where}: [quantity.{name}] has the same value for every device",
                value=float(own[0]),
                allowed="quantities that differ between devices",
                next_step="remove it",
            )


def _gyro_values(table: pa.Table, found: LotFile, where: str) -> tuple[FloatArray, FloatArray]:
    nan = np.full(table.num_rows, np.nan)
    named: dict[str, FloatArray] = {}
    sd: dict[str, FloatArray] = {}
    for name in NEEDED:
        column = f"{found.prefix}{name}"
        named[name] = _numbers(table, column, where, needed=False)
        sd[name] = np.nan_to_num(_numbers(table, f"{column}_sd", where, needed=False))
    if all(np.all(np.isnan(values)) for values in named.values()):
        raise MeasurementError(
            f"{where}: the table has no result quantity of gyroscreen",
            value=", ".join(table.column_names[:20]),
            allowed=", ".join(f"{found.prefix}{name}" for name in NEEDED),
            next_step="correct prefix, or describe the columns in [quantity.NAME] tables",
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        values = coordinates({name: named.get(name, nan) for name in NEEDED})
        covariance = propagated(named, sd)
    values = np.where(np.isfinite(values), values, np.nan)
    return values, np.where(np.isfinite(covariance), covariance, 0.0)


def _numbers(table: pa.Table, column: str, where: str, needed: bool = True) -> FloatArray:
    """(n,) of a column; nan where it is empty, or where an optional column does not exist."""
    if column not in table.column_names:
        if not needed:
            return np.full(table.num_rows, np.nan)
        check_known(column, table.column_names, where, "column")
    own: Any = table[column]
    if pa.types.is_null(own.type):
        return np.full(table.num_rows, np.nan)
    if pa.types.is_temporal(own.type):
        own = own.cast(pa.timestamp("us")).cast(pa.int64())
    if not (pa.types.is_floating(own.type) or pa.types.is_integer(own.type) or pa.types.is_boolean(own.type)):
        raise MeasurementError(
            f"{where}: a column holds no numbers",
            value=column,
            allowed="numbers",
            next_step="correct the column or its role",
        )
    found = np.asarray(own.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
    return np.where(np.isfinite(found), found, np.nan)
