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

from ...toml_keys import Meaning

Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
Text = Annotated[str, Meta(min_length=1, max_length=128)]


class LotColumns(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Names of the columns by role."""

    device: Annotated[Text, Meaning("column of the names of the devices")] = "device_id"
    lot: Annotated[Text, Meaning("column of the lots")] = "lot"
    wafer: Annotated[Text, Meaning("column of the wafers")] = "wafer"
    package: Annotated[Text, Meaning("column of the packages")] = "package"
    tester: Annotated[Text, Meaning("column of the testers")] = "tester"
    time: Annotated[Text, Meaning("column of the time of the measurement")] = "time"
    x_mm: Annotated[Text, Meaning("column of the die centre along x")] = "die_x_mm"
    y_mm: Annotated[Text, Meaning("column of the die centre along y")] = "die_y_mm"


class LotQuantity(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """One measured quantity."""

    column: Annotated[Text | None, Meaning("column of the quantity; absent: the name of the table")] = None
    sd: Annotated[
        float | Text | None,
        Meaning(
            "standard deviation of the measurement, or the column that holds it; absent: estimated",
            "that of the column",
        ),
    ] = None
    transform: Annotated[Literal["linear", "log"], Meaning("scale on which the quantity varies normally")] = "linear"
    unit: Annotated[str, Meaning("unit after scale, as pages show it")] = "1"
    scale: Annotated[float, Meaning("factor from the column to the unit", "unit per unit of the column")] = 1.0


class LotHold(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Wafers "lot/wafer" that are held out, or the share of them."""

    wafers: Annotated[
        tuple[str, ...] | None, Meaning('wafers "lot/wafer" that are held out; absent: a share of them')
    ] = None
    share: Annotated[
        float, Meta(ge=0.0, le=0.8), Meaning("share of the wafers that is held out; 0 holds nothing out", "1")
    ] = 0.2


class LotLimits(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Limits of one quantity, in its unit."""

    min: Annotated[float | None, Meaning("least conforming value", "that of the quantity")] = None
    max: Annotated[float | None, Meaning("largest conforming value", "that of the quantity")] = None


class LotWafer(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The wafer of the table."""

    radius_mm: Annotated[
        Positive | None, Meaning("radius of the wafer; absent: the largest distance of a die from the origin")
    ] = None


class LotFile(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """lot.toml."""

    file: Annotated[Text, Meaning("table beside lot.toml: Parquet or CSV")]
    name: Annotated[str | None, Meaning("name of the lot in answers; absent: the folder")] = None
    gyro: Annotated[
        bool,
        Meaning("whether the columns are result quantities of gyroscreen; else each is described in [quantity.NAME]"),
    ] = False
    prefix: Annotated[str, Meaning("before the names of the quantities in the table, for example true_")] = ""
    stage: Annotated[
        Literal["package", "probe"], Meaning("whether packaged devices or dies in the wafer prober were measured")
    ] = "package"
    columns: Annotated[LotColumns, Meaning("names of the columns by role")] = LotColumns()
    wafer: Annotated[LotWafer, Meaning("the wafer of the table")] = LotWafer()
    quantity: Annotated[dict[str, LotQuantity], Meaning("measured quantities, one table each")] = {}
    hold: Annotated[LotHold, Meaning("wafers that are held out")] = LotHold()
    limits: Annotated[
        dict[str, LotLimits], Meaning("limits of quantities that are no result quantities of gyroscreen")
    ] = {}
