"""A small measured lot of another product: quick to fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv


def write_metal_lot(folder: Path) -> None:
    """Write lot.toml and metal.csv: 6 wafers x 20 dies, thickness with a bow and limits, sheet resistance."""
    g = np.random.default_rng(2)
    wafer = np.repeat(np.arange(6), 20)
    x, y = g.uniform(-40, 40, (2, 120))
    bow = (x * x + y * y) / 50.0**2 - 0.5
    columns = {
        "lot": ["A"] * 120,
        "wafer": [f"W{w}" for w in wafer],
        "die_x_mm": x,
        "die_y_mm": y,
        "t": 500.0 * np.exp(0.01 * g.normal(size=6)[wafer] + 0.03 * bow + 0.01 * g.normal(size=120)),
        "c": np.full(120, 5.0),
        "r": 50.0 + g.normal(size=6)[wafer] + g.normal(size=120),
    }
    pa_csv.write_csv(pa.table(columns), folder / "metal.csv")
    (folder / "lot.toml").write_text(
        'file = "metal.csv"\nname = "metal"\n[quantity.thickness]\ncolumn = "t"\nunit = "nm"\ntransform = "log"\n'
        '[quantity.resistance]\ncolumn = "r"\nunit = "ohm"\nsd = 0.1\n[limits.thickness]\nmin = 490\nmax = 512\n',
        encoding="utf-8",
    )
