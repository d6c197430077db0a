"""The wafer map as a table: one row per device, with its place on the integer grid and its bins."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ..devices import Devices
from ..limits import Limits
from .bins import bins_of
from .dies import die_grid


def wafer_table(devices: Devices, limits: Limits) -> pa.Table:
    """The table in the order of lots, wafers, rows and columns of dies; units in the field metadata.

    Columns lot, wafer, die_x, die_y (grid, null where unknown), die_x_mm, die_y_mm, device_id, verdict, hard_bin, soft_bin,
    p_pass.
    """
    bins = bins_of(devices, limits)
    x_mm, y_mm = devices.number("die_x_mm"), devices.number("die_y_mm")
    dies = die_grid(x_mm, y_mm)
    texts = {name: pa.array(list(devices.text(name)), pa.string()) for name in ("lot", "wafer", "device_id", "verdict")}
    columns: dict[str, tuple[pa.Array, str]] = {
        "lot": (texts["lot"], ""),
        "wafer": (texts["wafer"], ""),
        "die_x": (pa.array(dies.x, pa.int32(), mask=~dies.known), "1"),
        "die_y": (pa.array(dies.y, pa.int32(), mask=~dies.known), "1"),
        "die_x_mm": (pa.array(x_mm, mask=~np.isfinite(x_mm)), "mm"),
        "die_y_mm": (pa.array(y_mm, mask=~np.isfinite(y_mm)), "mm"),
        "device_id": (texts["device_id"], ""),
        "verdict": (texts["verdict"], ""),
        "hard_bin": (pa.array(bins.hard, pa.int32()), "1"),
        "soft_bin": (pa.array(bins.soft, pa.int32()), "1"),
        "p_pass": (pa.array(devices.number("p_pass"), from_pandas=True), "1"),
    }
    schema = pa.schema(
        [pa.field(name, values.type, metadata={"unit": unit}) for name, (values, unit) in columns.items()]
    )
    table = pa.table([values for values, _ in columns.values()], schema=schema)
    return table.sort_by([(name, "ascending") for name in ("lot", "wafer", "die_y", "die_x")])
