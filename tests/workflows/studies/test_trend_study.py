"""The study of false alarms: rates with intervals, rows that continue, and a rate that a wrong chart would not have."""

from __future__ import annotations

import json

import pytest

from pipeline.errors import UsageError
from reports.trend.rules import RunRule
from workflows.cli import call
from workflows.studies import trend
from workflows.studies.hidden.study import rows_in


def test_normal_nights_alarm_at_the_stated_rate_and_shifted_ones_more_often():
    for nights in (3, 12):
        low, high = trend.normal_alarms(4000, nights, 0.05, 2).interval
        assert low < 0.05 < high
    assert trend.normal_alarms(4000, 12, 0.05, 2, shift=6.0).interval[0] > 0.2
    assert trend.normal_alarms(4000, 12, 0.05, 2, correlation=0.9).interval[0] < 0.05


def test_textbook_limits_on_ten_charts_would_not_have_the_stated_rate(monkeypatch):
    monkeypatch.setattr(trend, "calibrated", lambda *_: (RunRule(1, 1, 3.0), RunRule(2, 3, 2.0), RunRule(4, 5, 1.0)))
    assert trend.normal_alarms(4000, 12, 0.05, 2).interval[0] > 0.05


def test_rows_continue_and_their_figures_count_them(tmp_path, capfd):
    for count in (1, 2):
        list(trend.run_study(count, 5, tmp_path, 1))
    rows = rows_in(tmp_path, (trend.KIND,), 5)
    assert [row["number"] for row in rows] == [0, 1]
    assert rows[1] | {"cpu_seconds": 0} == trend.study_row(5, (trend.KIND, 1)) | {"cpu_seconds": 0}
    found = trend.figures(rows, 500, 5)
    assert found["population, 10 earlier nights, false alarms at 0.01"].total == 2
    assert (
        call(
            ["benchmark", "trend", "--nights", "0", "--series", "200", "--seed", "5", "--out", str(tmp_path), "--json"]
        )
        == 0
    )
    shown = json.loads(capfd.readouterr().out)
    assert "normal, 10 earlier nights, false alarms at 0.05" in shown


def test_a_folder_that_cannot_be_written_is_one_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError):
        list(trend.run_study(1, 5, tmp_path / "file", 1))
