"""The scaling study: its points, its stub devices, one small point, and the cost that follows from rows."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.store.schema import devices_schema, posterior_schema
from populations.draw import draw
from workflows.cli import call
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.guard import unguarded
from workflows.screening.parts import BlockItem
from workflows.screening.settings import population
from workflows.studies.scaling.cost import cost_of, cost_table, tables_of
from workflows.studies.scaling.points import DRAWS, STUB, VALUES, Point, config_of_point, points_of
from workflows.studies.scaling.stub import StubRows
from workflows.studies.scaling.study import rows_of, run_study

CONFIG = config_of_point(Point(DRAWS, 100, 1), 1)


def block(index, first, count):
    return StubRows()(CONFIG, BlockItem(DeviceBlock(index, first, count)), unguarded)


def test_points_vary_what_they_say_and_no_run_is_larger_than_allowed():
    points = points_of("all", 10_000)
    assert {point.kind for point in points} == set(VALUES)
    assert max(point.devices for point in points) == 10_000
    assert config_of_point(Point("order", 80, 0), 1).identification.order == 80
    assert config_of_point(Point("duration", 0.5, 0), 1).experiment.duration_s == 0.5
    assert config_of_point(Point("block", 25, 1), 1).run.block == 25


def test_stub_rows_have_the_schema_and_sites_of_the_draw_and_do_not_repeat():
    first, second = block(0, 0, 60), block(1, 60, 60)
    assert first.devices.schema == devices_schema()
    assert first.posterior.schema == posterior_schema()
    assert first.posterior.num_rows == 60 * 100
    drawn = draw(population(CONFIG), CONFIG.run.seed, 0, 60)
    for name in ("device_id", "lot", "wafer", "package", "die_x_mm", "die_y_mm"):
        assert first.devices.column(name).to_pylist() == list(getattr(drawn, name)), name
    theta = np.concatenate([one.devices.column("theta_deg").to_numpy() for one in (first, second)])
    assert np.unique(theta).size == theta.size
    again = block(0, 0, 60)
    assert again.devices.equals(first.devices)
    assert again.posterior.equals(first.posterior)


def test_stub_rows_have_as_many_nulls_as_real_ones():
    real = virtual_block(CONFIG, DeviceBlock(0, 0, 2)).devices
    stub = block(0, 0, 2).devices
    assert [column.null_count for column in stub.columns] == [column.null_count for column in real.columns]


def test_a_point_is_measured_once(tmp_path):
    point = Point(STUB, 100, 1)
    assert list(run_study([point], 1, tmp_path)) == [(1, 1)]
    (row,) = rows_of(tmp_path, 1)
    assert row["devices"] == 100
    assert row["blocks"] == 4
    assert min(row[key] for key in ("run_workers_cpu_s", "query_workers_cpu_s", "report_cpu_s", "bytes")) > 0
    assert list(run_study([point], 1, tmp_path)) == []
    assert not (tmp_path / "work").exists()
    assert "| stub | 100 | 1 |" in tables_of([row])


def row(kind, value, workers, **figures):
    zero = dict.fromkeys(
        ("run_cpu_s", "run_workers_cpu_s", "close_cpu_s", "query_cpu_s", "query_workers_cpu_s", "report_cpu_s"), 0.0
    )
    devices = value if kind != DRAWS else 10_000
    base = {"kind": kind, "value": value, "workers": workers, "devices": devices, "bytes": 0.0}
    return base | zero | {"peak_mb": 0.0, "report_peak_mb": 0.0} | figures


def test_the_cost_of_a_night_is_what_the_formulas_say():
    rows = [
        # 3 s to start, 40 ms or 50 ms a device
        *(row("device", n, 1, run_workers_cpu_s=3.0 + 0.04 * n) for n in (100, 1000)),
        *(row("device", n, 2, run_workers_cpu_s=6.0 + 0.05 * n) for n in (100, 1000)),
        # 0.1 ms of the driver and 1500 bytes a device; 300 MB and 1 kB a device
        *(
            row(STUB, n, w, run_cpu_s=1.0 + 1e-4 * n, bytes=1e6 + 1500 * n, report_peak_mb=300 + 1e-3 * n)
            for n in (100_000, 1_000_000)
            for w in (1, 2)
        ),
        *(row(DRAWS, n, 1, bytes=1e8 + 12_000 * 10_000 * (n > 0)) for n in (0, 100)),
    ]
    found = {cost.name: cost for cost in cost_of(rows, 10_000_000)}
    assert (found["core hours"].low, found["core hours"].high) == pytest.approx((4e5 / 3600, 5e5 / 3600))
    assert found["workers that it feeds"].low == pytest.approx(400.0)
    assert found["workers that it feeds"].high == pytest.approx(500.0)
    assert found["rows"].high == pytest.approx(15.0)
    assert found["posterior draws, 100 a device"].low == pytest.approx(120.0)
    assert found["memory of the report"].low == pytest.approx(10.3)
    assert "| core hours | 111 | 139 | h |" in cost_table(cost_of(rows, 10_000_000), 10_000_000)


def test_slopes_are_those_of_the_largest_runs_alone():
    rows = [row(STUB, n, w, bytes=1e6 + 1500 * n) for n, w in ((1000, 1), (10_000, 1), (100_000, 1), (1000, 2))]
    rows.append(row(STUB, 10_000, 2, bytes=0.0))
    (found,) = [cost for cost in cost_of(rows, 10_000_000) if cost.name == "rows"]
    assert (found.low, found.high) == pytest.approx((15.0, 15.0))


def test_what_was_not_measured_is_left_out():
    assert cost_of([row(STUB, 100, 1)], 10) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kind", "colour"], "no such kind of point: 'colour'"),
        (["--out", "{file}"], "cannot be written: file exists"),
    ],
)
def test_wrong_options_are_refused(options, message, tmp_path, capfd):
    (tmp_path / "file").write_text("", encoding="utf-8")
    given = [option.format(file=tmp_path / "file") for option in options]
    out = [] if "--out" in given else ["--out", str(tmp_path / "rows")]
    assert call(["benchmark", "scaling", *out, *given]) == 2
    assert message in capfd.readouterr().err
