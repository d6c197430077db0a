"""The page and the words of a trend: complete, escaped, the same for the same content, and plain for few nights."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from markup import PAYLOADS, added

from reports.limits import Limit
from reports.limits_origin import shipped_origin
from reports.trend.charted import CHARTED, COMPONENTS
from reports.trend.content import (
    InputChange,
    LeftOutNight,
    TrendContent,
    chart_alarms,
    charts_of,
    limit_alarms,
)
from reports.trend.difference import compared
from reports.trend.night import Grouping, Night
from reports.trend.page import render_trend
from reports.words import trend as words

NAMES = ("f1_hz", "quality1", *COMPONENTS)


def nights(count: int, seed: int = 1, shift: float = 0.0) -> list[Night]:
    random, found = np.random.default_rng(seed), []
    for k in range(count):
        lots = np.repeat(np.arange(4), 15)
        common = random.normal(0.0, 1.0, (4, 4))[:, lots]
        scale = np.array([2.0, 100.0, 0.3, 0.3])[:, None]
        centre = np.array([535.0, 2200.0, 0.1, -0.2])[:, None]
        values = centre + scale * (common + random.normal(0.0, 1.0, (4, lots.size)))
        values[0] += shift if k == count - 1 else 0.0
        found.append(
            Night(
                f"20260101T00000{k}-seed{k}",
                f"2026-01-{k + 1:02d}T04:10:00+00:00",
                tuple(f"D{i}" for i in range(lots.size)),
                values[0] > 534.0,
                dict(zip(NAMES, values, strict=True)),
                Grouping("lot", lots),
            )
        )
    return found


def content(series: Sequence[Night], limits: Sequence[Limit] = (), gated: bool = False) -> TrendContent:
    charts = charts_of([night.summary(NAMES) for night in series], NAMES, 0.01, [True] * len(series))
    tonight = series[-1]
    return TrendContent(
        run_id=tonight.run_id,
        created=tonight.created,
        devices=tonight.devices,
        comparison=compared(series[-2], tonight, NAMES, False) if len(series) > 1 else None,
        changes=(InputChange("population", "population.operating.lid_pressure_pa", "25.0", "60.0"),),
        charts=charts,
        nights=tuple(night.run_id for night in series),
        left_out=(
            LeftOutNight("20251231T000000-seed9", "not complete"),
            LeftOutNight("x", "judged by other limits", ("yield",)),
        ),
        false_alarm=0.01,
        alarms=chart_alarms(charts, tonight.run_id),
        broken_limits=limit_alarms(tonight.summary(NAMES), limits),
        gated=gated,
        limits=shipped_origin(),
    )


def test_a_night_in_control_says_so() -> None:
    found = content(nights(12))
    assert found.alarms == ()
    assert words.headline(found) == "In control"
    page = render_trend(found)
    assert page.count("<svg") == 1
    assert "population.operating.lid_pressure_pa" in page
    assert "not complete" in page
    assert "The limits are the shipped default, limits_default.toml" in page
    assert "src=" not in page
    assert page == render_trend(found)


def test_a_shifted_night_alarms_on_its_chart_and_in_words() -> None:
    found = content(nights(12, shift=-40.0), gated=True)
    assert {alarm.name for alarm in found.alarms} == {"f1_hz"}
    assert found.negative == found.alarms
    assert words.headline(found) == "Alarm: lower rocking frequency"
    page = render_trend(found)
    assert "is beyond the limits of one night" in page
    text = words.terminal(found)
    assert "\u00a0" not in text
    assert "Alarm: lower rocking frequency" in text
    assert not content(nights(12, shift=-40.0)).negative, "charts decide the exit code without the user's wish"


@pytest.mark.parametrize(
    ("limit", "broken"),
    [
        (Limit("yield", 0.99, math.inf), True),
        (Limit("yield", 0.01, 0.999), False),
        (Limit("f1_hz", -math.inf, 500.0), True),
        (Limit("f1_hz", 500.0, 600.0), False),
    ],
)
def test_limits_of_the_user_hold_for_the_value_of_the_night(limit: Limit, broken: bool) -> None:
    found = content(nights(5), [limit])
    assert bool(found.negative) == broken
    assert ("is beyond the limit that was set" in render_trend(found)) == broken


def test_a_night_without_a_value_breaks_its_limit_and_is_not_charted() -> None:
    series = nights(6)
    blind = replace(series[-1], values={**series[-1].values, "f1_hz": np.full(60, np.nan)})
    found = content([*series[:-1], blind], [Limit("f1_hz", 500.0, 600.0)])
    assert [alarm.name for alarm in found.negative] == ["f1_hz"]
    chart = next(one for one in found.charts if one.name == "f1_hz")
    assert len(chart.points) == 5
    assert "mean lower rocking frequency" in render_trend(found).lower()
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_nights_are_drawn_and_called_few(count: int) -> None:
    found = content(nights(count))
    page = render_trend(found)
    if count < 3:
        assert words.headline(found) in ("Too few nights to judge", "Different: lower rocking frequency")
        assert "Control limits need at least two" in page
    assert "nan" not in page.split("</style>")[1].lower().replace("nano", "")
    json.dumps(found.to_dict(), allow_nan=False)


def test_the_json_has_the_verdict_of_each_row_and_no_infinity() -> None:
    plain = content(nights(4)).to_dict()
    assert {row["name"] for row in plain["comparison"]["differences"]} == {"yield", *NAMES}
    assert all(isinstance(row["differs"], bool) for row in plain["comparison"]["differences"])
    assert [chart["name"] for chart in plain["charts"]] == ["yield", *NAMES]
    assert plain["charts"][0]["points"][0]["q"] is None
    json.dumps(plain, allow_nan=False)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_text_of_the_results_is_escaped(payload: str) -> None:
    # Without figures, which hold no text of the results and take two seconds to draw.
    plain = replace(content(nights(2)), charts=())
    hostile = replace(
        plain,
        changes=(InputChange("file", payload, payload, payload),),
        left_out=(LeftOutNight(payload, payload),),
        run_id=payload,
    )
    assert not added(render_trend(hostile), render_trend(plain))


def test_every_chartable_quantity_has_words() -> None:
    for name, unit in CHARTED.items():
        assert words.axis_label(name, unit)
        assert words.value_words(name, 0.5, 0.1)
    assert words.value_words("quadrature_rate_dps", -88.36, 10.0) == "−88 deg/s"
    assert words.range_words("f1_hz", -math.inf, 540.0, 0.0) == "at most 540 Hz"
