"""The content of a page: counted by hand on a few devices, and pinned on a synthetic run."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from pipeline.errors import ConfigError
from pipeline.store.schema import devices_table
from reports.devices import Devices
from reports.limits import DEFAULT_LIMITS, load_limits
from reports.run.calibration import check_verdicts, coverages
from reports.run.causes import pareto, stage_losses
from reports.run.content import facts, run_content
from reports.run.health import route_differences, status_counts
from reports.run.undetected import bias_bounds
from reports.run.worst import margins, worst_devices

LIMITS = load_limits(
    {"limits": {"split_hz": {"max": 3.0}, "quality1": {"min": 1200}, "theta_deg": {"min": 80, "max": 100}}}
)


def _devices(**columns: Any) -> Devices:
    n = len(next(iter(columns.values())))
    return Devices(devices_table({"device_id": [f"D{k}" for k in range(n)], "status": ["ok"] * n, **columns}))


def test_pareto_counts_failed_devices_once_a_limit() -> None:
    devices = _devices(
        verdict=["fail", "fail", "fail", "fail", "undecided", "pass"],
        failed_limits=["split_hz", "quality1,split_hz", "split_hz", "", "quality1", ""],
        split_hz=[4.0, 5.0, 6.0, 2.9, 2.0, 1.0],
        quality1=[2000.0, 900.0, 2000.0, 1300.0, 1190.0, 2000.0],
    )
    bars = pareto(devices, LIMITS)
    assert (bars.failed, bars.jointly) == (4, 1)
    assert [(row.limit.quantity, row.failed, row.alone) for row in bars.limits] == [
        ("split_hz", 3, 2),
        ("quality1", 1, 0),
        ("theta_deg", 0, 0),
    ]
    assert (bars.limits[0].above, bars.limits[0].below, bars.limits[1].below) == (3, 0, 1)


def test_stage_losses_count_fabrication_packaging_and_recovered_devices() -> None:
    fine = [2000.0] * 5
    devices = _devices(
        fab_split_hz=[1.0, 1.0, 5.0, 5.0, None],
        true_split_hz=[1.0, 5.0, 1.0, 5.0, 1.0],
        fab_quality1=fine,
        true_quality1=fine,
        # The turn from 89 to -89 deg is one of 2 deg and stays inside the arc.
        fab_theta_deg=[89.0] * 5,
        true_theta_deg=[-89.0] * 5,
    )
    whole, split, _, theta = stage_losses(devices, LIMITS)
    for row in (whole, split):
        assert (row.both, row.packaging, row.recovered, row.fabrication, row.unknown) == (1, 1, 1, 1, 1)
    assert whole.limit is None
    assert (theta.both, theta.unknown) == (5, 0)


def test_a_measured_batch_has_no_stages_no_calibration_and_no_check() -> None:
    devices = _devices(verdict=["pass"], split_hz=[1.0])
    assert stage_losses(devices, LIMITS) == ()
    assert coverages(devices) == ()
    assert check_verdicts(devices, LIMITS) is None
    assert route_differences(devices) == ()


@pytest.mark.parametrize("centre", [0.0, 89.99, -89.99])
def test_calibrated_intervals_of_an_axis_are_in_the_band_at_any_angle(centre: float) -> None:
    rng = np.random.default_rng(1)
    n, sd, z90 = 2000, 0.5, 1.6448536
    truth = centre + rng.normal(0.0, 1.0, n)
    estimate = truth + rng.normal(0.0, sd, n)

    def row(sd_claimed: float) -> Any:
        turn = lambda angle: 90.0 - np.mod(90.0 - angle, 180.0)  # noqa: E731
        (found,) = coverages(
            _devices(
                theta_deg=turn(estimate),
                theta_deg_sd=np.full(n, sd_claimed),
                theta_deg_q05=turn(estimate - z90 * sd_claimed),
                theta_deg_q95=turn(estimate + z90 * sd_claimed),
                true_theta_deg=turn(truth),
            )
        )
        return found

    right, proud = row(sd), row(0.7 * sd)
    assert right.in_band
    # rms of z has sd 1/sqrt(2n).
    assert right.z_rms == pytest.approx(1.0, abs=4 / np.sqrt(2 * n))
    assert right.beyond_3 == pytest.approx(0.0027, abs=4 * np.sqrt(0.0027 / n))
    assert not proud.in_band
    assert proud.z_rms == pytest.approx(1.0 / 0.7, rel=0.1)


def test_devices_that_are_not_ok_do_not_count_in_the_calibration() -> None:
    devices = _devices(
        status=["ok", "misfit"],
        split_hz=[1.0, 1.0],
        split_hz_sd=[0.1, 0.1],
        split_hz_q05=[0.8, 0.8],
        split_hz_q95=[1.2, 1.2],
        true_split_hz=[1.1, 9.0],
    )
    (row,) = coverages(devices)
    assert (row.devices, row.inside) == (1, 1)


def test_wrong_verdicts_are_counted_against_the_truth() -> None:
    limits = load_limits({"limits": {"split_hz": {"max": 3.0}}})
    devices = _devices(
        verdict=["pass", "pass", "fail", "fail", "undecided"],
        p_pass=[0.99, 0.96, 0.01, 0.04, None],
        true_split_hz=[1.0, 3.1, 9.0, 2.9, 1.0],
    )
    check = check_verdicts(devices, limits)
    assert check is not None
    assert check.table == (("pass", 1, 1), ("undecided", 1, 0), ("fail", 1, 1))
    assert check.found == 2
    assert check.expected == pytest.approx(2.0)


def test_worst_devices_have_four_kinds_and_no_repetition() -> None:
    devices = _devices(
        status=["ok", "ok", "ok", "ok", "misfit", "fit_failed"],
        verdict=["pass", "undecided", "fail", "undecided", "undecided", "undecided"],
        split_hz=[2.9, 3.0, 6.0, 3.01, 1.0, None],
        error=[1.0, 1.0, 1.0, 1.0, 4.0, None],
        p_pass=[1.0, 0.5, 0.0, 0.2, None, None],
    )
    worst = worst_devices(devices, load_limits({"limits": {"split_hz": {"max": 3.0}}}), each=1)
    assert [device.device_id for device in worst] == ["D5", "D1", "D2", "D0"]
    assert worst[0].why == "not identified: fit_failed"
    assert margins(devices, LIMITS)[2] == -1.0
    assert np.isnan(margins(devices, LIMITS)[5])


def test_theta_of_the_route_is_compared_as_an_axis() -> None:
    devices = _devices(theta_deg=[89.5], true_theta_deg=[-89.5], theta_u1_deg=[-90.0 + 0.1])
    rows = {row.name: row for row in route_differences(devices)}
    assert rows["theta_u1_deg"].posterior_median == pytest.approx(0.6)
    assert rows["theta_deg"].truth_median == pytest.approx(1.0)


def test_bounds_of_undetected_effects_are_compared_with_sds_and_limits() -> None:
    devices = _devices(
        status=["ok", "ok", "ok", "misfit"],
        split_hz_sd=[1e-3] * 4,
        split_hz_bias_bound=[3e-3, 4e-3, 8e-3, 5.0],
        f3_hz_sd=[1e-2] * 4,
        f3_hz_bias_bound=[None, 1e-2, None, None],
    )
    rows = {row.quantity: row for row in bias_bounds(devices, load_limits({"limits": {"split_hz": {"max": 2.0}}}))}
    assert list(rows) == ["split_hz", "f3_hz"]
    assert rows["split_hz"].devices == 3
    assert rows["split_hz"].median == pytest.approx(4.0)
    assert rows["split_hz"].of_limits == pytest.approx(2e-3)
    assert rows["f3_hz"].devices == 1
    assert np.isnan(rows["f3_hz"].of_limits)


def test_status_and_reason_are_counted_ok_first() -> None:
    devices = _devices(status=["misfit", "ok", "misfit", "ok", "ok"], status_reason=["a", None, "a", None, None])
    assert [(row.status, row.reason, row.devices) for row in status_counts(devices)] == [
        ("ok", "", 3),
        ("misfit", "a", 2),
    ]


def test_wafers_of_two_lots_never_share_a_name() -> None:
    devices = _devices(lot=["L1", "L10", "L1", None, "L2"], wafer=["L10-W1", "L10-W1", "W1", "W1", None])
    assert tuple(devices.wafers()) == ("L1 L10-W1", "L10-W1", "L1 W1", "W1", "")


def test_reasons_that_differ_in_numbers_only_are_counted_together() -> None:
    devices = _devices(status=["misfit"] * 3, status_reason=["error 1.2 above 1.1", "error 3e+02 above 1.1", "bias"])
    assert [(row.reason, row.devices) for row in status_counts(devices)] == [("error … above …", 2), ("bias", 1)]


def test_nested_facts_become_dotted_lines() -> None:
    rows = facts({"seed": 7, "versions": {"numpy": "2.4"}, "empty": None, "sweep": [1.0, 2.5]})
    assert [(row.name, row.value) for row in rows] == [("seed", "7"), ("versions.numpy", "2.4"), ("sweep", "1, 2.5")]


def test_the_content_of_the_synthetic_run_equals_its_reference_values(synthetic_run: Callable[..., Any]) -> None:
    content = run_content(synthetic_run(), DEFAULT_LIMITS, {"spec": "synthetic"})
    percent = "\u00a0%"
    assert (content.total.passed, content.total.failed, content.total.undecided) == (77, 99, 24)
    assert content.headline.cause == "Quadrature rate outside −600 to 600 deg/s"
    assert content.headline.share == (
        f"88 of the 99 failed devices break this limit (88.9{percent}, 95{percent} interval 81.0 to 94.3{percent}), "
        "31 of them no other limit."
    )
    assert content.headline.stage == (
        f"According to the virtual truth, 76 of 107 lost devices were outside the limits as fabricated and 31 (29.0{percent}) "
        "were lost in packaging. Packaging brought 9 back inside the limits."
    )
    assert content.headline.undecided == (
        "Undecided: 11 too close to a limit, 10 not converged, 3 misfit. However they are decided, the yield of "
        f"these devices lies between 38.5{percent} and 50.5{percent}."
    )
    assert [(one.by, one.groups) for one in content.clusters] == [("wafer", 4), ("lot", 2)]
    assert [file.name for file in content.files] == ["devices-00000.parquet"]
    assert content.run_id == "synthetic"


@pytest.mark.parametrize(
    ("verdict", "yielded", "sentence"),
    [
        ("undecided", (0.0, 1.0), "lies between 0\u00a0% and 100\u00a0%"),
        ("pass", (0.9075, 1.0), "No device failed."),
        ("fail", (0.0, 0.0925), "38 of the 38 failed devices break this limit (100\u00a0%"),
    ],
)
def test_equal_verdicts_of_all_devices_are_reported_with_an_interval(
    synthetic_run: Callable[..., Any], verdict: str, yielded: tuple[float, float], sentence: str
) -> None:
    run = synthetic_run(38)
    table = run.devices
    values = {"verdict": [verdict] * 38, "failed_limits": ["split_hz" if verdict == "fail" else ""] * 38}
    for column, text in values.items():
        table = table.set_column(table.column_names.index(column), table.schema.field(column), pa.array(text))
    content = run_content(dataclasses.replace(run, devices=table), DEFAULT_LIMITS)
    assert (content.total.envelope.low, content.total.envelope.high) == pytest.approx(yielded, abs=1e-4)
    assert sentence in " ".join(dataclasses.astuple(content.headline))


def test_content_is_frozen_and_equal_for_equal_input(synthetic_run: Callable[..., Any]) -> None:
    run = synthetic_run(30)
    content = run_content(run, DEFAULT_LIMITS)
    assert content.total == run_content(run, DEFAULT_LIMITS).total
    assert content.pareto == run_content(run, DEFAULT_LIMITS).pareto
    with pytest.raises(dataclasses.FrozenInstanceError):
        content.run_id = "other"  # type: ignore[misc]


def test_limits_on_absent_columns_are_refused(synthetic_run: Callable[..., Any]) -> None:
    run = synthetic_run(5)
    bare = dataclasses.replace(run, devices=pa.table({"device_id": ["D0"], "verdict": ["pass"]}))
    with pytest.raises(ConfigError, match="not in the results"):
        run_content(bare, DEFAULT_LIMITS)


def test_common_errors_widen_every_interval_of_the_yield(
    synthetic_run: Callable[..., Any],
) -> None:
    run = synthetic_run(n=60, draws=100)
    before = run_content(run, DEFAULT_LIMITS)
    # In one half of the values of the common errors every device conforms, in the other none.
    p_pass = pa.array((run.posterior["draw"].to_numpy() % 2).astype(np.float64))
    place = run.posterior.schema.names.index("p_pass_given_common")
    posterior = run.posterior.set_column(place, run.posterior.schema.field(place), p_pass)
    moved = dataclasses.replace(run, posterior=posterior)
    after = run_content(moved, DEFAULT_LIMITS)
    assert (before.common, after.common) == (False, True)
    assert after.total.value == before.total.value
    for wide, plain in (
        *((getattr(after.total, k), getattr(before.total, k)) for k in ("clopper_pearson", "wilson", "envelope")),
        *((a.interval, b.interval) for a, b in zip(after.clusters, before.clusters)),
        *((a.result.wilson, b.result.wilson) for a, b in zip(after.wafers, before.wafers)),
    ):
        assert wide.low < plain.low
        assert wide.high > plain.high
    assert after.measurement.sd == pytest.approx(30.0)
    assert after.verdict_check is not None
    assert after.verdict_check.expected_sd == pytest.approx(30.0)
