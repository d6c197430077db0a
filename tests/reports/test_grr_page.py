"""The page of a gauge R&R: limits of its charts against published constants, cells, order of parts, the page itself."""

from __future__ import annotations

import numpy as np
import pytest

from reports.gauge import GaugeData, gauge_study
from reports.grr.content import GaugeContent, cells_of, gauge_chart, mean_limits, sd_limits
from reports.grr.page import render_gauge
from reports.limits import Limit
from reports.limits_origin import LimitsOrigin
from tests.markup import PAYLOADS, added
from tests.reports.test_gauge import aiag

PARTS, TESTERS = [f"A{n + 1}" for n in range(10)], ["T1", "T2", "T3"]


def chart(data=None, parts=PARTS, testers=TESTERS):
    data = aiag() if data is None else data
    study = gauge_study("split_hz", data, Limit("split_hz", -4.0, 4.0))
    return gauge_chart(study, data, parts, testers, False)


def test_the_limits_of_sds_are_those_of_the_published_constants():
    # Montgomery, Statistical Quality Control, appendix VI: B5, c4, B6 of samples of 3, 6 and 10.
    low, centre, high = sd_limits(1.0, np.array([2, 5, 9, 0]))
    assert centre[:3] == pytest.approx([0.8862, 0.9515, 0.9727], abs=5e-5)
    assert low[:3] == pytest.approx([0.0, 0.029, 0.276], abs=5e-4)
    assert high[:3] == pytest.approx([2.276, 1.874, 1.669], abs=6e-4)
    assert np.isnan([low[3], centre[3], high[3]]).all()


def test_the_cells_are_means_and_repeats_by_tester_and_part():
    found = chart()
    data = aiag()
    assert found.cells.part.tolist() == list(range(10)) * 3
    for k in range(30):
        own = data.value[(data.part == k % 10) & (data.tester == k // 10)]
        assert found.cells.mean[k] == pytest.approx(own.mean())
        assert found.cells.sd[k] == pytest.approx(own.std(ddof=1))
    low, high = mean_limits(found.study, found.cells.count)
    # AIAG's figure: most of the means are beyond the limits, as they should be.
    assert ((found.cells.mean < low) | (found.cells.mean > high)).mean() > 0.5


def test_repeats_are_those_within_a_session():
    value = np.array([1.0, 1.2, 5.0, 5.2, 7.0])
    session = np.array([0, 0, 1, 1, 0])
    found = cells_of(GaugeData(value, np.array([0, 0, 0, 0, 1]), np.zeros(5, int), session))
    assert found.sd[0] == pytest.approx(np.sqrt(0.02))
    assert found.df.tolist() == [2, 0]
    assert np.isnan(found.sd[1])
    assert found.count.tolist() == [4, 1]


def test_parts_stand_in_the_order_of_their_names_and_gaps_are_left_out():
    data = aiag()
    value = data.value.copy()
    value[:3] = np.nan
    names = [f"A{n}" for n in (10, 9, 8, 7, 6, 5, 4, 3, 2, 1)]
    found = chart(GaugeData(value, data.part, data.tester, data.session), names)
    assert found.parts == tuple(f"A{n}" for n in range(1, 11))
    assert found.data.value.size == 87
    own = found.data.value[(found.data.part == 9) & (found.data.tester == 1)]
    assert own.tolist() == value[3:6].tolist()


def page(*charts):
    return render_gauge(GaugeContent("r1", charts, LimitsOrigin("command line", "/lab/own.toml", "ab" * 32)))


def test_the_page_states_the_published_result_with_its_interval():
    text = page(chart())
    assert "27.9 % of the study variation (15.4 to 81.6)" in text
    assert "--limits /lab/own.toml (sha256 abababababab)" in text
    assert text.count("<svg") == 1
    assert text == page(chart())


@pytest.mark.parametrize("testers", [1, 9])
def test_any_design_gives_a_page(testers):
    random = np.random.default_rng(2)
    part, tester, _ = (a.ravel() for a in np.meshgrid(range(40), range(testers), range(2), indexing="ij"))
    data = GaugeData(random.normal(size=part.size) + part, part, tester, np.zeros(part.size, int))
    names = [f"P{n}" for n in range(40)]
    text = page(chart(data, names, ["" if testers == 1 else f"T{n}" for n in range(testers)]))
    assert text.count("<svg") == 1
    assert f"{80 * testers} measurements of 40 parts by {testers} testers" in text


def test_names_of_parts_and_testers_add_no_markup():
    names = [*PAYLOADS[:8], "$A_1$", "A2"]
    assert not added(page(chart(parts=names, testers=list(PAYLOADS[-3:]))), page(chart()))
