"""Answers of the loop as pandas tables, from their JSON.

pandas takes a quarter of a second to load: only who asks for a table waits for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.device.model import Model
from pipeline.quantities import QUANTITIES

if TYPE_CHECKING:
    import pandas as pd

Said = Mapping[str, Any]

_RUNG = (
    "status", "error_fit", "error_validate", "misfit_fit", "misfit_validate", "relative_error", "explained", "delta_chi2",
    "held_out_fall", "held_out_sd",
)  # fmt: skip


def where_table(said: Said) -> pd.DataFrame:
    """One row a region: family, kind, where it lies, share of the misfit in its family, error there."""
    import pandas as pd

    table = pd.DataFrame([dict(row) for row in said.get("where", ())]).dropna(axis="columns", how="all")
    return table.astype({"harmonic": "Int64"}) if "harmonic" in table else table


def records_table(said: Said) -> pd.DataFrame:
    """One row a record: role and error."""
    import pandas as pd

    return pd.DataFrame.from_dict(dict(said.get("records", {})), orient="index").rename_axis("record")


def parameters_table(said: Said, model: Model) -> pd.DataFrame:
    """One row a parameter: value, sd, unit."""
    import pandas as pd

    units = _units(model)
    rows = {name: (*value, units.get(name, "")) for name, value in said.get("parameters", {}).items()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["value", "sd", "unit"]).rename_axis("parameter")


def candidates_table(said: Said) -> pd.DataFrame:
    """One row an absent effect, the most significant first; sizes as {parameter: (value, sd)}."""
    import pandas as pd

    rows = [
        {k: v for k, v in row.items() if k != "estimate"}
        | {"estimate": {k: tuple(v) for k, v in row.get("estimate", {}).items()}}
        for row in said.get("candidates", ())
    ]
    table = pd.DataFrame(rows)
    return table.set_index("effect") if "effect" in table else table


def ladder_table(said: Said) -> pd.DataFrame:
    """One row a rung, from the model as given upward: errors, fall of chi2, theta, split and verdict with that model."""
    import pandas as pd

    rows = []
    for k, rung in enumerate(said.get("ladder", ())):
        row = {"rung": k, "effect": rung.get("effect") or "", **{name: rung.get(name) for name in _RUNG}}
        for name, (value, sd) in rung.get("derived", {}).items():
            row |= {name: value, f"{name}_sd": sd}
        rows.append(row | {"verdict": rung.get("verdict"), "verdict_at_face": rung.get("verdict_at_face")})
    table = pd.DataFrame(rows)
    return table.set_index("rung") if rows else table


def _units(model: Model) -> dict[str, str]:
    named = {quantity.name: quantity.unit for quantity in QUANTITIES}
    return {**named, **{name: parameter.unit for name, parameter in model.parameters()}}


def html(tables: Sequence[pd.DataFrame]) -> str:
    """Tables below one another."""
    return "\n".join(table.to_html(border=0, float_format=lambda value: f"{value:.6g}") for table in tables)
