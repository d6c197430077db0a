"""The page of the results tables, from the registered schema."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.quantities import DERIVED, MODEL, PERFORMANCE, Quantity
from pipeline.store.irregularity_table import IRREGULARITIES
from pipeline.store.schema import DEVICES, POSTERIOR, Column

from .markdown import NOTE, code, plain, table

_TYPES = {
    "string": "text",
    "float64": "number",
    "float32": "number, 32 bit",
    "int32": "whole number",
    "int64": "whole number",
}
#: Columns that every quantity has; the page describes them once.
_OF_A_QUANTITY = ("{}", "{}_sd", "{}_q05", "{}_q95", "true_{}", "fab_{}", "{}_bias_bound")
_ABOUT = """\
# Columns of the results

A run stores three tables as Parquet. `gyroscreen query` offers them as views, `gs.open_run()` as tables. Units are in the
names of the columns, in the metadata of the Arrow fields, and in the view `columns`. A value that is not known is null,
never NaN. An infinite standard deviation means that the records do not determine the quantity.

| table | one row per | where |
|---|---|---|
| `devices` | device | `devices-*.parquet`, view `devices`, `gs.open_run().devices` |
| `posterior` | posterior draw of a device | `posterior-*.parquet`, view `posterior`, `gs.open_run().posterior` |
| `irregularities` | random number of a virtual device | `irregularities-*.parquet`, view `irregularities` |

The posterior draws are thinned to `posterior.stored_draws` per device, which run.toml states. 0 stores none.
"""


def columns_page() -> str:
    """Markdown of the page."""
    quantities = (*MODEL, *DERIVED, *PERFORMANCE)
    described = {form.format(one.name) for one in quantities for form in _OF_A_QUANTITY}
    others = [column for column in DEVICES if column.name not in described]
    parts = [
        NOTE,
        _ABOUT,
        "## Quantities\n",
        "Each quantity `q` of the table below has these columns in `devices`:\n",
        table(("column", "meaning"), [(code(form.format("q")), _meaning(form)) for form in _OF_A_QUANTITY]),
        "The columns `true_q` and `fab_q` are null for a measured device. Performance figures have no bound.\n",
        *_quantities("Parameters of the model", MODEL),
        *_quantities("Derived from the parameters", DERIVED),
        *_quantities("Performance in operation", PERFORMANCE),
        "## Other columns of `devices`\n",
        _columns(others),
        "## Columns of `posterior`\n",
        _columns(POSTERIOR),
        "## Columns of `irregularities`\n",
        _columns(IRREGULARITIES),
    ]
    return "\n".join(parts)


def _quantities(title: str, quantities: Sequence[Quantity]) -> tuple[str, str]:
    rows = [(code(one.name), plain(one.meaning), plain(one.unit)) for one in quantities]
    return f"### {title}\n", table(("quantity", "meaning", "unit"), rows)


def _meaning(form: str) -> str:
    """The meaning of such a column, as that of the first quantity that is no axis states it."""
    example = next(one for one in MODEL if not one.axis)
    name = form.format(example.name)
    if name == example.name:
        return "estimate: the median of the posterior, for an axis the circular median"
    meaning = next(column.meaning for column in DEVICES if column.name == name)
    shown = plain(meaning).replace(plain(example.name), "`q`")
    arc = next(column.meaning for column in DEVICES if column.name == form.format(MODEL[0].name))
    return f"{shown}; for theta {plain(arc)}" if "q05" in form or "q95" in form else shown


def _columns(columns: Sequence[Column]) -> str:
    rows = [(code(one.name), plain(one.meaning), plain(one.unit), _TYPES[one.type]) for one in columns]
    return table(("column", "meaning", "unit", "type"), rows)
