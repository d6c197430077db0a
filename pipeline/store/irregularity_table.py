"""The table ``irregularities``: the random numbers that each virtual device was drawn with, one row a number.

Numbers of a lot or wafer are repeated in the rows of its devices, so that the table joins with ``devices`` by device_id; Parquet
stores the repeated names in a few bits.  All numbers are standard normal: a uniform number u is stored as Phi^-1(u), a random
field on a wafer as its value at the die.  float32 is ample, as the rounding is 1e-7 of one standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

from .manifest import Kind
from .schema import Column, arrow_schema, build_table, devices_schema, posterior_schema

IRREGULARITIES: tuple[Column, ...] = (
    Column("irregularities", "device_id", "string", "", "name of the device"),
    Column("irregularities", "irregularity", "string", "", "irregularity that reads the number"),
    Column("irregularities", "level", "string", "", "lot, wafer, die or package: devices of a lot or wafer share it"),
    Column(
        "irregularities",
        "label",
        "string",
        "",
        "which number of that level; field: a random field at the die; uniform at the end: Phi of the value is uniform",
    ),
    Column("irregularities", "component", "int32", "1", "number within the label, from 0"),
    Column("irregularities", "value", "float32", "1", "standard normal number of the device"),
)


@cache
def irregularities_schema() -> pa.Schema:
    """Registered schema of ``irregularities``."""
    return arrow_schema(IRREGULARITIES)


def irregularities_table(values: Mapping[str, Sequence[Any] | np.ndarray[Any, Any]]) -> pa.Table:
    """Build an ``irregularities`` table from column name -> (n,) values; raises as :func:`.schema.build_table`."""
    return build_table(values, IRREGULARITIES, irregularities_schema())


def schema_of(kind: Kind) -> pa.Schema:
    """Registered schema of a table."""
    tables = {"devices": devices_schema, "posterior": posterior_schema, "irregularities": irregularities_schema}
    return tables[kind]()
