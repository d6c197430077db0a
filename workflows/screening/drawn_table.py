"""The table ``irregularities`` of a block: what its virtual devices were drawn with."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from pipeline.store.irregularity_table import irregularities_table
from populations.draw import Draw


def drawn_table(drawn: Draw) -> pa.Table:
    """The numbers of a draw, device by device, in the order in which the irregularities read them."""
    names, values = drawn.numbers.names, drawn.numbers.values
    count = len(drawn.device_id)
    return irregularities_table(
        {
            "device_id": [name for name in drawn.device_id for _ in names],
            "irregularity": [name.irregularity for name in names] * count,
            "level": [name.level for name in names] * count,
            "label": [name.label for name in names] * count,
            "component": np.tile(np.array([name.component for name in names], dtype=np.int32), count),
            "value": np.ascontiguousarray(values.T, dtype=np.float32).ravel(),
        }
    )
