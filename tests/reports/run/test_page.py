"""The page: self-contained, escaped, the same for the same input, and complete for few devices or missing columns."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Callable
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pyarrow as pa
import pytest
from markup import PAYLOADS, added

from pipeline.store.schema import devices_table
from reports.html.rendering import interval, measured, number
from reports.html.style import style
from reports.limits import DEFAULT_LIMITS, load_limits
from reports.run.figures.causes import CauseBar, pareto_bars
from reports.run.page import render_run_report
from reports.words.quantities import percent
from reports.words.rules import rule_words

Build = Callable[..., Any]
ARC = load_limits({"limits": {"theta_deg": {"min": 60, "max": 140}, "split_hz": {"max": 3.0}}})


class _Elements(HTMLParser):
    """Tags, ids and addresses of a page; unclosed elements are an error."""

    VOID = ("meta", "link", "br", "img", "hr", "input", "path", "use", "rect", "circle", "line")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.ids: Counter[str] = Counter()
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        for name, value in attrs:
            if name == "id":
                self.ids[value or ""] += 1
            if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                self.addresses.append(value or "")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(synthetic_run: Build) -> str:
    return render_run_report(synthetic_run(), DEFAULT_LIMITS, population_summary={"spec": "synthetic"})


def test_the_page_has_no_external_addresses(page: str) -> None:
    elements = _Elements(page)
    assert elements.open == []
    assert all(address.startswith("#") for address in elements.addresses)
    assert {address[1:] for address in elements.addresses} <= set(elements.ids)
    assert "http:" not in page
    assert "https:" not in page
    assert not elements.tags.keys() & {"script", "link", "img", "iframe", "object", "embed"}
    assert not re.search(r"@import|url\((?!#)", page)


def test_no_two_figures_share_an_id(page: str) -> None:
    assert max(_Elements(page).ids.values()) == 1
    used = set(re.findall(r"url\(#([^)]+)\)", page))
    assert used <= set(_Elements(page).ids)


def test_the_header_states_yield_interval_counts_and_cause(page: str) -> None:
    head = page[page.index("<header>") : page.index("</header>")]
    text = " ".join(re.sub(r"<[^>]+>", " ", head).replace("\u00a0", " ").split())
    for part in (
        "38.5 %",
        "31.7 to 45.6 %",
        "Quadrature rate outside −600 to 600 deg/s",
        "77 pass",
        "24 undecided",
        "99 fail",
    ):
        assert part in text


def test_every_section_is_present_with_its_figure(page: str) -> None:
    elements = _Elements(page)
    for name in (
        "causes",
        "yield",
        "wafers",
        "distributions",
        "calibration",
        "health",
        "route",
        "worst",
        "capability",
        "risks",
        "limits",
        "provenance",
    ):
        assert elements.ids[name] == 1
    # Twelve figures and a corner plot for each of the four kinds of worst devices.
    assert elements.tags["svg"] == 16
    assert "0123abc" in page
    assert rule_words(DEFAULT_LIMITS.rule) in page


def test_the_same_run_gives_the_same_page_and_a_small_one(page: str, synthetic_run: Build) -> None:
    assert render_run_report(synthetic_run(), DEFAULT_LIMITS, population_summary={"spec": "synthetic"}) == page
    assert len(page.encode()) < 1_500_000


def test_a_page_of_many_devices_stays_below_2_mb(synthetic_run: Build) -> None:
    many = render_run_report(synthetic_run(3000, draws=25, wafers=30), DEFAULT_LIMITS)
    assert len(many.encode()) < 2_000_000
    assert "The first 12 of 30 wafers" in many


def test_markup_in_names_is_escaped(synthetic_run: Build) -> None:
    evil = "<script>alert('x')</script>\"&"
    run = synthetic_run(12)
    table = run.devices
    for column in ("device_id", "lot", "wafer", "status_reason", "status", "cause"):
        place = table.column_names.index(column)
        table = table.set_column(place, table.schema.field(column), pa.array([evil] * 12))
    posterior = run.posterior.set_column(0, run.posterior.schema.field(0), pa.array([evil] * run.posterior.num_rows))
    run = dataclasses.replace(
        run, devices=table, posterior=posterior, config_toml=evil, manifest={"run_id": evil, evil: evil}
    )
    hostile = render_run_report(run, DEFAULT_LIMITS, population_summary={evil: evil})
    assert "script" not in _Elements(hostile).tags
    assert "<script" not in hostile
    assert "&lt;script&gt;" in hostile


def test_no_payload_reaches_the_page_as_markup(synthetic_run: Build) -> None:
    """Every device has another payload in each of its texts; the manifest, run.toml and the summary have all."""
    pages = []
    for evil in (PAYLOADS, ["plain"] * len(PAYLOADS)):
        run = synthetic_run(len(PAYLOADS))
        table = run.devices
        for column in ("device_id", "lot", "wafer", "status_reason", "cause"):
            place = table.column_names.index(column)
            table = table.set_column(place, table.schema.field(column), pa.array(evil))
        every = " ".join(evil)
        run = dataclasses.replace(run, devices=table, config_toml=every, manifest={"run_id": every, "created": every})
        pages.append(render_run_report(run, DEFAULT_LIMITS, population_summary={every: every}))
    assert len(PAYLOADS) == 100
    assert added(*pages) == set()
    assert pages[0] != pages[1]


def test_a_run_without_devices_gives_a_page_that_states_it(synthetic_run: Build) -> None:
    run = synthetic_run(4)
    empty = dataclasses.replace(run, devices=run.devices.slice(0, 0), posterior=None)
    page = render_run_report(empty, DEFAULT_LIMITS)
    assert "holds no devices" in page
    assert "No devices: nothing to judge." in page
    assert _Elements(page).open == []


@pytest.mark.parametrize(("n", "limits"), [(1, ARC), (2, DEFAULT_LIMITS)])
def test_one_or_two_devices_give_a_page(synthetic_run: Build, n: int, limits: Any) -> None:
    run = dataclasses.replace(synthetic_run(n, wafers=1, limits=limits), posterior=None)
    assert "Main cause of loss" in render_run_report(run, limits)


def test_a_measured_batch_without_truth_or_wafers_gives_a_page(synthetic_run: Build) -> None:
    page = render_run_report(dataclasses.replace(synthetic_run(40, virtual=False), posterior=None), DEFAULT_LIMITS)
    ids = _Elements(page).ids
    assert ids["wafers"] == 0
    assert ids["route"] == 1
    assert "No virtual truth in this run" in page
    assert "In truth" not in page


def test_devices_without_any_value_give_a_page() -> None:
    table = devices_table({"device_id": ["A", "B"], "status": ["fit_failed"] * 2, "verdict": ["undecided"] * 2})

    page = render_run_report(SimpleNamespace(devices=table, posterior=None, manifest=None, config_toml=""), ARC)
    assert "Undecided: 2 fit failed" in page


def test_figures_do_not_change_the_settings_of_matplotlib() -> None:
    before = dict(matplotlib.rcParams)
    with style():
        assert matplotlib.rcParams["svg.fonttype"] == "none"
    pareto_bars([CauseBar("split", 3, 1)], 4)
    assert dict(matplotlib.rcParams) == before


def test_numbers_are_rounded_by_their_sd() -> None:
    assert measured(-30.76432, 0.0123) == "−30.764 ± 0.012"
    assert measured(1234.5, 60.0) == "1234 ± 60"
    assert measured(3.167e-4, 2e-7) == "0.00031670 ± 0.00000020"
    assert number(2.2e-6, 2) == "2.2·10⁻⁶"
    assert (number(6.2e-12, 1), number(7.0, 1)) == ("6·10⁻¹²", "7")
    assert measured(1.0, float("nan")) == "1.00000 ± ?"
    assert measured(float("nan"), 1.0) == "–"
    assert interval(0.99, 1.011, 0.0096) == "0.9900 to 1.0110"
    assert (number(1.0, 4), number(float("inf")), number(None), number(1409.2)) == ("1.000", "∞", "–", "1409")


def test_shares_near_0_and_1_are_not_rounded_to_them() -> None:
    shares = [0.0, 0.0004, 0.385, 0.9996, 1.0, np.nan]
    assert [percent(share).replace("\u00a0", " ") for share in shares] == [
        "0 %",
        "0.04 %",
        "38.5 %",
        "99.96 %",
        "100 %",
        "–",
    ]
