"""The page of an answer shows the values of its content in tables and figures, and has no external addresses."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from markup import PAYLOADS, added

from pipeline.device.effect import find_effects
from pipeline.learning.answers import PairAnswer, Place, TermTest
from reports.learning.page import render_learning_page
from reports.learning.record_view import RecordView
from reports.words.campaign import notes

Build = Callable[..., Any]
NONE = "–"


class Parsed(HTMLParser):
    """Tags, addresses, ids, the text outside figures, and tables as cells; an unclosed element is an error."""

    VOID = ("meta", "br", "img", "path", "use", "rect", "image")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.figures: list[str] = []
        self.open: list[str] = []
        self.tables: dict[tuple[str, ...], list[list[str]]] = {}
        self._rows: list[list[str]] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []
        self.text = re.sub(r"\s+", " ", " ".join(self.words))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.figures += [value or "" for name, value in attrs if name == "aria-label"]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "table":
            self._rows = []
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag
        if tag == "table":
            cells = [[re.sub(r"\s+", " ", cell).strip() for cell in row] for row in self._rows]
            self.tables[tuple(cells[0])] = cells[1:]

    def handle_data(self, data: str) -> None:
        if {"style", "svg"} & set(self.open):
            return
        self.words.append(data)
        if {"td", "th"} & set(self.open):
            self._rows[-1][-1] += f" {data}"


def render(name: str, comparison: Any, diagnosis: Any = None, refinement: Any = None, **more: Any) -> str:
    return render_learning_page(name, comparison, diagnosis, refinement, library=find_effects(), **more)


@pytest.fixture(scope="module")
def page(comparison: Build, diagnosis: Build, refinement: Build, record: Build) -> str:
    before = [record(), record("other level", "validate", 1.0)]
    after = [record(cubic=0.0), record("other level", "validate", 1.0, 0.0)]
    return render("A17", comparison(), diagnosis(), refinement(), before=before, after=after, truth="k3 = 1.2e9")


def test_the_ladder_table_has_the_errors_of_each_model(page: str) -> None:
    tables = Parsed(page).tables
    head = ("model", "status", "error, fitted", "error, held out", "misfit, fitted", "misfit, held out", "misfit explained",
            "decrease of χ², fitted", "decrease of χ², held out")  # fmt: skip
    assert tables[head] == [
        ["first model", NONE, "14.0", "12.3", "14.0", "12.3", NONE, NONE, NONE],
        ["+ cubic stiffness", "confirmed", "1.00", "1.00", "0.0450", "0.00", "99.6 %", "490000", "2000 ± 90"],
    ]
    assert tables["model", "theta, deg", "split, Hz", "relative error", "verdict on the device"] == [
        ["first model", "89.90 ± 0.10", "2.000 ± 0.010", "2.0 %", "fail"],
        ["+ cubic stiffness", "−89.90 ± 0.10", "2.100 ± 0.010", "2.0 %", "pass"],
    ]


def test_the_table_of_places_has_share_and_error(page: str) -> None:
    rows = Parsed(page).tables["by frequency", "share of the misfit", "error"]
    assert rows == [
        ["resonance, 380 to 420 Hz, chirp, sense 1", "", "70.0 %", "30.0"],
        ["3rd harmonic of the drive", "", "20.0 %", "3.00"],
    ]


def test_the_table_of_candidates_has_estimate_with_unit_and_snr(page: str) -> None:
    rows = Parsed(page).tables["effect", "decrease of χ²", "p", "estimate", "error after", "detectable (SNR)"]
    assert rows == [
        ["cubic stiffness", "", "500000", "< 10⁻⁹⁹", "k3 = (1.2000 ± 0.0020)·10⁹ 1/(V² s⁴)", "1.00", "yes (40)"],
        ["angular rate", "", "0.500", "1", NONE, "1.00", "no (40)"],
    ]


def test_the_table_of_parameters_has_the_shift_in_sds(page: str) -> None:
    rows = {
        row[0]: row[1:] for row in Parsed(page).tables["parameter", "unit", "first model", "last model", "shift, sd"]
    }
    assert rows["theta"] == ["deg", "89.90 ± 0.10", "−89.90 ± 0.10", "2.0"]
    assert rows["lower rocking frequency"] == ["Hz", "399.000 ± 0.010", "400.000 ± 0.010", "100"]
    assert rows["cubic stiffness: k3"] == ["1/(V² s⁴)", NONE, "(1.2100 ± 0.0020)·10⁹", NONE]


def test_the_headline_comes_first_and_the_hidden_effect_last(page: str) -> None:
    text = Parsed(page).text
    order = [
        "What was missing: cubic stiffness.",
        "The error fell from 12.3 to 1.00 on the held-out records.",
        "k3 = 1.2e9",
    ]
    assert sorted(order, key=text.index) == order


def test_every_figure_is_on_the_page(page: str) -> None:
    assert [label.partition(",")[0] for label in dict.fromkeys(Parsed(page).figures)] == [
        "Error and misfit of each model of the ladder",
        "Measured",
        "Residual over time and frequency in units of the noise",
        "Residual against the level of the response",
        "Error of every record and channel",
    ]


def test_the_page_has_no_external_addresses_and_ids_are_unique(page: str) -> None:
    found = Parsed(page)
    assert all(address.startswith(("#", "data:image/png;base64,")) for address in found.addresses)
    assert {a[1:] for a in found.addresses if a.startswith("#")} <= set(found.ids)
    assert len(found.ids) == len(set(found.ids))
    assert not found.tags & {"script", "link", "iframe", "object", "embed"}
    assert "http:" not in page
    assert "https:" not in page
    assert len(page) < 2_000_000


def test_the_same_input_gives_the_same_page(
    comparison: Build, diagnosis: Build, refinement: Build, record: Build
) -> None:
    def build() -> str:
        return render("A17", comparison(), diagnosis(), refinement(), before=[record()], after=[record(cubic=0.0)])

    assert build() == build()


def test_what_does_not_apply_is_left_out(comparison: Build) -> None:
    found = Parsed(render("A17", comparison(where=())))
    assert set(found.ids) == {"where", "parameters"}
    assert set(found.tables) == {("parameter", "unit", "value")}
    assert found.figures == []


def test_numbers_that_are_not_known_are_dashes(comparison: Build, diagnosis: Build, candidate: Build) -> None:
    unknown = candidate(error_after=math.inf, estimate={"f": (60.0, None), "g": (math.nan, None)}, snr_at_reach=None)
    page = render("A17", comparison(parameters={"f1_hz": (math.nan, None)}), diagnosis(candidates=(unknown,)))
    found = Parsed(page)
    assert found.tables["parameter", "unit", "value"] == [["lower rocking frequency", "Hz", NONE]]
    assert next(rows for head, rows in found.tables.items() if head[0] == "effect")[0][4:] == [
        "f = 60.0000 g = –",
        NONE,
        "yes",
    ]
    assert not re.search(r"\b(nan|None|inf|UNSET)\b", found.text)


def test_markup_in_names_is_escaped(
    comparison: Build, diagnosis: Build, refinement: Build, candidate: Build, record: Build
) -> None:
    evil = '<script>alert("x")</script>&$x_{$'
    page = render(
        evil,
        comparison(where=(Place("resonance", evil, evil, None, 0.7, 30.0, family=evil),)),
        diagnosis(effects=(evil,), candidates=(candidate(effect=evil),), invisible=(evil,)),
        refinement(last={"effect": evil, "status": evil, "verdict": evil}, refused={evil: evil}, effects=(evil,)),
        before=[record(evil)], truth=evil,
    )  # fmt: skip
    assert "<script" not in page
    assert "script" not in Parsed(page).tags
    assert evil in Parsed(page).text


def test_records_of_any_shape_are_drawn_or_left_out(comparison: Build, record: Build) -> None:
    view = record()
    one = RecordView("1 x 1", "fit", 4000.0, view.drive_v[:, :1], view.measured_v[:, :1], view.model_v[:, :1],
                     view.residual[:, :1], 9.0)  # fmt: skip
    silent = RecordView("silent", "fit", 4000.0, np.zeros((6000, 1)), view.residual[:, :1] * 1e-3, np.zeros((6000, 1)),
                        view.residual[:, :1], 1.0)  # fmt: skip
    short = RecordView("short", "fit", 4000.0, *(np.zeros((3, 1)) for _ in range(4)), 0.0)
    page = render("A17", comparison(), before=[one, silent, short])
    spectrograms = [label for label in Parsed(page).figures if label.startswith("Residual over time")]
    assert len(spectrograms) == 2
    assert not re.search(r"\bnan\b", page)


def _entry(share: float, relative: float, model: tuple[float, float]) -> Place:
    return Place("resonance", "eq14", "sense1", (534.0, 535.0), share, None, mode=1, drive="drive2",
                 relative_error=relative, measured=(0.5, 0.1), model=model)  # fmt: skip


def test_a_modal_record_has_f_tests_and_thetas_and_no_held_out_columns(
    comparison: Build, diagnosis: Build, candidate: Build, rung: Build, refinement: Build
) -> None:
    unknown: dict[str, Any] = {
        "error_fit": None,
        "error_validate": None,
        "misfit_fit": None,
        "misfit_validate": None,
        "dof": 18,
    }
    four = {
        "four_thetas_deg": dict.fromkeys("abcd", (-33.0, 1.0)),
        "theta_deg": (-33.0, 1.0),
        "theta_spread_deg": 5.68,
    }
    rival = TermTest("loop_delay", 10.7, (1, 18), 0.37, 0.004, 0.025)
    ladder = (
        rung(effect=None, status=None, relative_error=0.099, verdict="", **unknown, **four),
        rung(
            status="partial",
            relative_error=0.027,
            verdict="",
            F=11.6,
            p_value=0.0085,
            rivals=(rival,),
            **unknown,
            **four,
        ),
    )
    tested = candidate(error_after=None, F=11.6, share_of_chi2=0.392, p_single=0.0015, relative_error_after=0.077)
    page = render(
        "eq14",
        comparison(error={"fit": None}, where=(_entry(0.3, 0.09, (0.4, 0.1)),), dof=19),
        diagnosis(
            candidates=(tested,),
            pairs=(PairAnswer(("loop_delay", "mains_hum"), 0.765, 2e-4),),
            declared=("angular_rate",),
        ),
        refinement(ladder=ladder, where=(_entry(0.2, 0.01, (0.49, 0.1)),)),
    )
    tables = Parsed(page).tables
    assert tables["model", "status", "relative error", "F", "p", "next candidates"] == [
        ["first model", NONE, "9.9 %", NONE, NONE, NONE],
        ["+ cubic stiffness", "partial", "2.7 %", "11.6", "0.0085", "loop delay (p 0.025)"],
    ]
    assert [row[-1] for row in tables["model", "theta, deg", "split, Hz", "spread of the four thetas, deg"]] == [
        "5.68",
        "5.68",
    ]
    assert tables["by mode and entry (sense/drive)", "share of the misfit", "relative error", "after"] == [
        ["mode 1 (534.5 Hz), S1/D2", "", "30.0 %", "9.0 %", "1.0 %"]
    ]
    head = ("effect", "F", "share of χ²", "p alone", "p", "estimate", "relative error after", "detectable (SNR)")
    assert tables[head][0][1:5] == ["11.6", "39.2 %", "0.0015", "< 10⁻⁹⁹"]
    assert tables["pair", "share of χ²", "p"] == [["loop delay and mains hum", "76.5 %", "2·10⁻⁴"]]
    labels = [label.partition(" ")[0] for label in Parsed(page).figures]
    assert labels == ["Error", "The", "Residues"]


@pytest.mark.filterwarnings("ignore:Glyph")  # fonts lack some of the letters
def test_no_payload_reaches_the_page_as_markup(
    comparison: Build, diagnosis: Build, refinement: Build, candidate: Build, record: Build
) -> None:
    pages = []
    for evil in (" ".join(PAYLOADS), "plain"):
        pages.append(
            render(
                evil,
                comparison(where=(Place("resonance", evil, evil, None, 0.7, 30.0, family=evil),)),
                diagnosis(effects=(evil,), candidates=(candidate(effect=evil),), invisible=(evil,)),
                refinement(
                    last={"effect": evil, "status": evil, "verdict": evil}, refused={evil: evil}, effects=(evil,)
                ),
                before=[record(evil)],
                truth=evil,
            )
        )
    assert added(*pages) == set()
    assert pages[0] != pages[1]


def test_effects_that_were_never_refitted_are_not_shown_as_refused(comparison: Build, refinement: Build) -> None:
    refused = {
        "gain_drift": "its size is not significant",
        "pickoff_pole": "its expected decrease is below 1 % of the misfit",
    }
    partial = {"status": "partial", "held_out_fall": 13.0, "held_out_sd": 10.0}
    page = render("A17", comparison(), None, refinement(last=partial, refused=refused, not_refitted=("pickoff_pole",)))
    read = Parsed(page)
    assert read.tables["gain drift", "its size is not significant"] == []
    text = " ".join(" ".join(read.words).split())
    assert "not refitted, because too little of the misfit was expected of it: pick-off pole" in text
    assert "held out: 1.3 sd, 2 would confirm it" in text
    assert page.count(">refused<") == 1


def test_a_ladder_that_ends_with_significant_effects_names_them_and_says_how_to_go_on(refinement: Build) -> None:
    note = notes(refinement(verdict="unknown", not_tried=("gain_drift", "pickoff_pole")))[-1]
    assert "effects were not tried: gain drift and pick-off pole" in note
    assert "gyroscreen refine --model" in note
    assert "not tried" not in " ".join(notes(refinement(verdict="unknown")))
