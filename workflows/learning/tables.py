"""Answers as pandas tables.  pandas is imported where a table is made, because it takes a quarter of a second to load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from pipeline.device.model import Model
from pipeline.learning.answers import CandidateAnswer, Place, RecordErrors, RungAnswer, Values, to_builtins
from pipeline.quantities import QUANTITIES

if TYPE_CHECKING:
    import pandas as pd

_RUNG = (
    "status", "error_fit", "error_validate", "misfit_fit", "misfit_validate", "relative_error", "explained", "delta_chi2",
    "held_out_fall", "held_out_sd",
)  # fmt: skip


def where_table(places: Sequence[Place]) -> pd.DataFrame:
    """One row per place: family, kind, location, share of the misfit in its family, error."""
    import pandas as pd

    table = pd.DataFrame([to_builtins(place) for place in places]).dropna(axis="columns", how="all")
    return table.astype({"harmonic": "Int64"}) if "harmonic" in table else table


def records_table(records: Mapping[str, RecordErrors]) -> pd.DataFrame:
    """One row per record: role, error [sigma], error in volts and relative error."""
    import pandas as pd

    rows = {name: to_builtins(errors) for name, errors in records.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("record")


def parameters_table(values: Values, model: Model, effects: Sequence[str] = ()) -> pd.DataFrame:
    """One row per parameter of ``model`` with ``effects``: value and sd in its unit, and the unit."""
    import pandas as pd

    for effect in effects:
        model = model.with_effect(effect)
    units = {quantity.name: quantity.unit for quantity in QUANTITIES}
    units |= {name: parameter.unit for name, parameter in model.parameters()}
    rows = {name: (*value, units.get(name, "")) for name, value in values.items()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["value", "sd", "unit"]).rename_axis("parameter")


def candidates_table(candidates: Sequence[CandidateAnswer]) -> pd.DataFrame:
    """One row per absent effect, the most significant first; sizes as {parameter: (value, sd)}."""
    import pandas as pd

    table = pd.DataFrame([{**to_builtins(one), "estimate": dict(one.estimate)} for one in candidates])
    return table.set_index("effect") if "effect" in table else table


def ladder_table(ladder: Sequence[RungAnswer]) -> pd.DataFrame:
    """One row per rung, from the given model on: errors, delta_chi2, theta [deg], split [Hz], verdict."""
    import pandas as pd

    rows = []
    for k, rung in enumerate(ladder):
        row = {"rung": k, "effect": rung.effect or "", **{name: getattr(rung, name) for name in _RUNG}}
        for name, (value, sd) in rung.derived.items():
            row |= {name: value, f"{name}_sd": sd}
        rows.append(row | {"verdict": rung.verdict or None, "verdict_at_face": rung.verdict_at_face or None})
    table = pd.DataFrame(rows)
    return table.set_index("rung") if rows else table


def html(lines: Sequence[str], tables: Sequence[pd.DataFrame]) -> str:
    """Lines of text, then tables.  The text may hold names of files and effects; pandas escapes it."""
    import pandas as pd

    text = pd.DataFrame({"": list(lines)}).to_html(index=False, header=False, border=0)
    shown = [table.to_html(border=0, float_format=lambda value: f"{value:.6g}") for table in tables]
    return "\n".join([text, *shown])
