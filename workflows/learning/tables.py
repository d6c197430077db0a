"""Answers as pandas tables.  pandas is imported where a table is made, because it takes a quarter of a second to load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.device.model import Model
from pipeline.learning.answers import Answer, CandidateAnswer, Place, RecordErrors, RungAnswer, Values, to_builtins
from pipeline.quantities import QUANTITIES

if TYPE_CHECKING:
    import pandas as pd

_RUNG = (
    "status", "error_fit", "error_validate", "misfit_fit", "misfit_validate", "relative_error", "explained", "delta_chi2",
    "held_out_fall", "held_out_sd",
)  # fmt: skip


#: A pair of numbers in an answer -> its two columns.
_PAIRS = {
    "band_hz": ("band_low_hz", "band_high_hz"), "time_s": ("time_from_s", "time_to_s"),
    "response_v": ("response_low_v", "response_high_v"), "measured": ("measured_re", "measured_im"),
    "model": ("model_re", "model_im"), "F_dof": ("F_dof", "F_dof_residual"),
}  # fmt: skip


def _numbers(answer: Answer) -> dict[str, Any]:
    """An answer as one row: each pair of numbers as two columns of numbers."""
    row: dict[str, Any] = {}
    for name, value in to_builtins(answer).items():
        row |= dict(zip(_PAIRS[name], value or (None, None))) if name in _PAIRS else {name: value}
    return row


def where_table(places: Sequence[Place]) -> pd.DataFrame:
    """One row per place: family, kind, location, share of the misfit in its family, error."""
    import pandas as pd

    table = pd.DataFrame([_numbers(place) for place in places]).dropna(axis="columns", how="all")
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
    """One row per absent effect, the most significant first; ``sizes_table`` has their sizes."""
    import pandas as pd

    table = pd.DataFrame([_numbers(one) for one in candidates]).drop(columns="estimate", errors="ignore")
    return table.set_index("effect") if "effect" in table else table


def sizes_table(candidates: Sequence[CandidateAnswer], model: Model) -> pd.DataFrame:
    """One row per parameter of each absent effect: value and sd by one step from the given model, and the unit."""
    import pandas as pd

    effects = model.library
    units = {
        (name, known): p.unit
        for name in {one.effect for one in candidates} & effects.keys()
        for p in effects[name].members(model.built.shape)
        for known in (p.name, effects[name].full_name(p))
    }
    rows = [
        (one.effect, name, *value, units.get((one.effect, name), ""))
        for one in candidates
        for name, value in one.estimate.items()
    ]
    names = ["effect", "parameter", "value", "sd", "unit"]
    return pd.DataFrame(rows, columns=names).set_index(["effect", "parameter"])


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
