import math

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import UsageError
from pipeline.quantities import NAMES
from pipeline.store.digest import table_digest
from pipeline.store.schema import COLUMNS, devices_schema, devices_table, posterior_schema, posterior_table

VALUES = st.lists(
    st.tuples(st.text(st.characters(codec="utf-8"), min_size=1), st.one_of(st.none(), st.floats(allow_nan=False))),
    min_size=1,
    max_size=8,
)


def test_every_quantity_has_its_estimate_interval_and_truth() -> None:
    names = set(devices_schema().names)
    for q in NAMES:
        assert {q, f"{q}_sd", f"{q}_q05", f"{q}_q95", f"true_{q}", f"fab_{q}"} <= names


def test_names_end_in_the_unit_that_the_metadata_give() -> None:
    suffix = {"_deg": "deg", "_hz": "Hz", "_mm": "mm", "_dps": "deg/s", "_per_s": "1/s"}
    for column in COLUMNS:
        stem = column.name.removesuffix("_sd").removesuffix("_q05").removesuffix("_q95")
        for ending, unit in suffix.items():
            if stem.endswith(ending) and not stem.endswith(f"_per{ending}"):
                assert column.unit == unit, column
        assert column.meaning
        assert (column.unit == "") == (column.type == "string"), column


def test_schema_carries_units_and_meanings() -> None:
    for schema in (devices_schema(), posterior_schema()):
        for field in schema:
            assert set(field.metadata) == {b"unit", b"meaning"}
            assert field.nullable


def test_absent_columns_and_nan_are_null_and_infinity_stays() -> None:
    table = devices_table({"device_id": ["a", "b"], "theta_deg": [np.nan, math.inf], "lot": None})
    assert table.schema.equals(devices_schema(), check_metadata=True)
    assert table.column("theta_deg").to_pylist() == [None, math.inf]
    assert table.column("lot").null_count == table.column("true_f1_hz").null_count == 2


@pytest.mark.parametrize(
    ("columns", "match"),
    [
        ({"device_id": ["a"], "thetadeg": [1.0]}, "no such column: 'thetadeg'"),
        ({"device_id": ["a"], "theta_deg": [1.0, 2.0]}, "theta_deg has the wrong length: 2"),
        ({"device_id": ["a"], "theta_deg": ["much"]}, "theta_deg holds values of the wrong type"),
        ({"theta_deg": [1.0]}, "needs a device_id"),
        ({"device_id": ["a", None]}, "needs a device_id"),
    ],
)
def test_wrong_columns_are_refused_by_name(columns: dict[str, list[object]], match: str) -> None:
    with pytest.raises(UsageError, match=match):
        devices_table(columns)


@given(VALUES, st.data())
def test_digest_depends_on_values_alone(rows: list[tuple[str, float | None]], data: st.DataObject) -> None:
    def build(values: list[float | None]) -> pa.Table:
        return pa.table({"name": [row[0] for row in rows], "x": pa.array(values, pa.float64())})

    values = [row[1] for row in rows]
    table = build(values)
    cut = data.draw(st.integers(0, len(rows)))
    pieces = pa.concat_tables([table.slice(0, cut), table.slice(cut)]).replace_schema_metadata({"a": "b"})
    assert table_digest(pieces) == table_digest(table)
    changed = data.draw(st.integers(0, len(rows) - 1))
    old = values[changed]
    values[changed] = 0.0 if old is None else math.nextafter(old, math.inf) if math.isfinite(old) else None
    assert table_digest(build(values)) != table_digest(table)


def test_digest_sees_signed_zeros_shifted_text_and_order() -> None:
    def digest(ids: list[str], theta: list[float | None]) -> str:
        return table_digest(devices_table({"device_id": ids, "theta_deg": theta}))

    assert digest(["a"], [0.0]) != digest(["a"], [-0.0])
    assert digest(["a"], [0.0]) != digest(["a"], [None])
    assert digest(["ab", "c"], [1.0, 1.0]) != digest(["a", "bc"], [1.0, 1.0])
    assert digest(["a", "b"], [1.0, 2.0]) != digest(["b", "a"], [2.0, 1.0])


def test_digest_ignores_values_under_a_null() -> None:
    masked = [pa.array(np.array([under]), mask=np.array([True])) for under in (1.0, 2.0)]
    one, two = (pa.table([array], names=["x"]) for array in masked)
    assert table_digest(one) == table_digest(two)


def test_posterior_has_the_sampled_quantities() -> None:
    table = posterior_table({"device_id": ["a"], "draw": [0]})
    assert table.schema.names[:4] == ["device_id", "draw", "theta_deg", "split_hz"]
    assert table.schema.field("draw").type == pa.int32()


def test_texts_come_back_row_by_row() -> None:
    names = ["ä", "b", "", "ä", "b"]
    lots = ["x", None, float("nan"), "", "x"]
    table = devices_table({"device_id": names, "lot": lots})
    assert table.column("device_id").to_pylist() == names
    assert table.column("lot").to_pylist() == ["x", None, None, "", "x"]
    nothing = devices_table({"device_id": names[:2], "lot": np.full(2, np.nan)})
    assert nothing.column("lot").null_count == 2
