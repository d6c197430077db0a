"""The keys of lot.toml: which columns a table has, and what they mean.

file = "lot.parquet"             # or CSV, beside lot.toml
gyro = true                      # the columns are result quantities of gyroscreen; else [quantity.NAME] tables
stage = "package"                # or "probe": dies in the wafer prober
prefix = ""                      # of the quantities, for example "true_"
[columns]                        # roles; each has its own name as default, and only device, lot, wafer are usual everywhere
lot = "lot"
wafer = "wafer"
x_mm = "die_x_mm"
[wafer]
radius_mm = 50.0                 # default: the largest distance of a die from the origin
[quantity.thickness]
column = "Thickness"             # default: the name of the table
sd = 0.5                         # of the measurement, or a column
transform = "log"                # or "linear"
unit = "nm"
scale = 0.1                      # to that unit
[hold]
wafers = ["L01/W02"]             # or share = 0.2; share = 0 holds nothing out
[limits.thickness]               # of a quantity that is no result quantity of gyroscreen
min = 199.0
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
Text = Annotated[str, Meta(min_length=1, max_length=128)]


class LotColumns(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Names of the columns by role."""

    device: Text = "device_id"
    lot: Text = "lot"
    wafer: Text = "wafer"
    package: Text = "package"
    tester: Text = "tester"
    time: Text = "time"
    x_mm: Text = "die_x_mm"
    y_mm: Text = "die_y_mm"


class LotQuantity(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One measured quantity."""

    column: Text | None = None
    sd: float | Text | None = None
    transform: Literal["linear", "log"] = "linear"
    unit: str = "1"
    scale: float = 1.0


class LotHold(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Wafers "lot/wafer" that are held out, or the share of them."""

    wafers: tuple[str, ...] | None = None
    share: Annotated[float, Meta(ge=0.0, le=0.8)] = 0.2


class LotLimits(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Limits of one quantity, in its unit."""

    min: float | None = None
    max: float | None = None


class LotWafer(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The wafer of the table."""

    radius_mm: Positive | None = None


class LotFile(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """lot.toml."""

    file: Text
    name: str | None = None
    gyro: bool = False
    prefix: str = ""
    stage: Literal["package", "probe"] = "package"
    columns: LotColumns = LotColumns()
    wafer: LotWafer = LotWafer()
    quantity: dict[str, LotQuantity] = {}
    hold: LotHold = LotHold()
    limits: dict[str, LotLimits] = {}
