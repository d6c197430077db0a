"""The page of a campaign: a sentence that says what was missing, pictures that show it, and nothing that leaves it."""

from __future__ import annotations

import copy
import html
import math
import re
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from reports.learning.page import RecordView, effect_texts, render_campaign_report
from reports.learning.record_view import by_level, drive_band, drive_frequency, sigma_v, spectra, time_frequency
from reports.words.campaign import p_words, typeset

RATE, N, SIGMA = 4000.0, 6000, 1e-3
T = np.arange(N) / RATE


def _record(name: str, role: str, amplitude: float, cubic: float, seed: int) -> RecordView:
    """Two crossing sweeps through a resonance; what the model lacks is the third harmonic of the response."""
    sweep = 2 * np.pi * (300.0 * T + 0.5 * (500.0 - 300.0) / T[-1] * T**2)
    back = 2 * np.pi * (500.0 * T - 0.5 * (500.0 - 300.0) / T[-1] * T**2)
    drive = amplitude * np.stack([np.sin(sweep), np.sin(back)], axis=1)
    passage = np.exp(-(((T - 0.5 * T[-1]) / 0.12) ** 2))[:, None]
    model = amplitude * passage * np.stack([np.sin(sweep), np.cos(sweep)], axis=1)
    noise = SIGMA * np.random.default_rng(seed).standard_normal((N, 2))
    measured = model + cubic * model**3 + 0.02 + noise
    volts = measured - model
    residual = (volts - volts.mean(axis=0)) / SIGMA
    return RecordView(name, role, RATE, drive, measured, model, residual, float(np.sqrt(np.mean(residual**2))))


BEFORE = [_record("chirp", "fit", 2.0, 4e-3, 1), _record("other level", "validate", 1.0, 4e-3, 2)]
AFTER = [_record("chirp", "fit", 2.0, 0.0, 1), _record("other level", "validate", 1.0, 0.0, 2)]
COMPARE: dict[str, Any] = {
    "error": {"fit": 14.0, "validate": 12.3},
    "relative_error": {"fit": 0.02, "validate": 0.018},
    "noise": {"sigma": [SIGMA, SIGMA], "from": "silent"},
    "where": [
        {"record": "chirp", "channel": 1, "band_hz": [380.0, 420.0], "kind": "resonance", "share": 0.7, "error": 30.0},
        {"kind": "harmonic", "harmonic": 3, "share": 0.2, "error": 3.0},
    ],
    "parameters": {"f1_hz": [399.0, 0.01], "f2_hz": [401.0, 0.01], "theta_deg": [89.9, 0.1], "split_hz": [2.0, 0.01]},
    "fit_ok": True,
}
DIAGNOSE: dict[str, Any] = {
    "verdict": "effect",
    "effects": ["cubic_stiffness"],
    "candidates": [
        {
            "effect": "cubic_stiffness",
            "delta_chi2": 5e5,
            "p_value": 1e-200,
            "estimate": {"cubic_stiffness.k3": [1.2e9, 2e6]},
            "error_after": 1.0,
            "class": 0,
            "could_have_shown": True,
        },
        {"effect": "angular_rate", "delta_chi2": 0.5, "p_value": 1.0, "estimate": {}, "detectable": False},
    ],
    "separating_record": None,
    "classes": [],
    "invisible": ["updown_tilt"],
    "error": {"fit": 14.0, "validate": 12.3},
}
REFINE: dict[str, Any] = {
    "ladder": [
        {"effect": None, "status": None, "error_fit": 14.0, "error_validate": 12.3, "delta_chi2": 0.0},
        {
            "effect": "cubic_stiffness",
            "status": "confirmed",
            "error_fit": 1.001,
            "error_validate": 1.0,
            "misfit_fit": 0.045,
            "delta_chi2": 4.9e5,
            "parameters": {"f1_hz": [400.0, 0.01], "cubic_stiffness.k3": [1.21e9, 2e6]},
        },
    ],
    "verdict": "adequate",
    "effects": ["cubic_stiffness"],
    "classes": [],
    "theta_deg": [-89.9, 0.1],
    "split_hz": [2.1, 0.01],
    "theta_before_deg": [89.9, 0.1],
}


class _Page(HTMLParser):
    """Tags, addresses and the text outside figures and style; unclosed elements are an error."""

    VOID = ("meta", "br", "img", "path", "use", "rect", "image")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href", "data")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "svg"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


def _head(page: str) -> str:
    """The text of the head, without the figures."""
    found = re.search(r"<header.*?</header>", page, re.S)
    assert found
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", found[0])))


@pytest.fixture(scope="module")
def page() -> str:
    return render_campaign_report(
        "A17", COMPARE, DIAGNOSE, REFINE, BEFORE, AFTER,
        verdicts={"before": "fail", "after": "pass"}, truth="cubic_stiffness: k3 = 1.2e9", provenance={"seed": 7},
    )  # fmt: skip


def test_the_head_says_what_was_missing_and_how_far_the_error_fell(page: str) -> None:
    head = _head(page)
    assert "What was missing: cubic stiffness." in head
    assert "The error fell from 12.3 to 1.00 on records the fit had not seen." in head
    assert "1.00 is the noise floor" in head
    assert "fail → pass" in head
    # The head comes first, the truth last but for the provenance.
    assert page.index("What was missing") < page.index('id="ladder"') < page.index('id="truth"')
    assert "k3 = 1.2e9" in page[page.index('id="truth"') :]


def test_nothing_on_the_page_leaves_it_and_ids_are_unique(page: str) -> None:
    seen = _Page(page)
    assert seen.open == []
    assert all(address.startswith(("#", "data:image/png;base64,")) for address in seen.addresses)
    assert {a[1:] for a in seen.addresses if a.startswith("#")} <= set(seen.ids)
    assert len(seen.ids) == len(set(seen.ids))
    assert not seen.tags & {"script", "link", "iframe", "object", "embed"}
    assert "http:" not in page
    assert "https:" not in page
    assert len(page) < 2_000_000


def test_every_picture_is_there(page: str) -> None:
    for picture in (
        "Error and misfit of each model",
        "Measured, model and residual spectra",
        "Residual over time and frequency",
        "Residual against the level",
        "Error of every record and channel",
    ):
        assert f'aria-label="{picture}' in page


def test_the_same_input_gives_the_same_page(page: str) -> None:
    again = render_campaign_report(
        "A17", copy.deepcopy(COMPARE), copy.deepcopy(DIAGNOSE), copy.deepcopy(REFINE), list(BEFORE), list(AFTER),
        verdicts={"before": "fail", "after": "pass"}, truth="cubic_stiffness: k3 = 1.2e9", provenance={"seed": 7},
    )  # fmt: skip
    assert again == page


_ONE = {"effect": None, "status": None, "error_fit": 1.0, "error_validate": 1.004}


@pytest.mark.parametrize(
    ("diagnose", "refine", "said"),
    [
        ({"verdict": "effect", "effects": ["pickoff_pole"]}, None, "What is missing: pick-off pole."),
        (
            {"verdict": "class", "effects": ["pickoff_pole"], "classes": [["pickoff_pole", "loop_delay"]]},
            None,
            "What is missing: pick-off pole or loop delay.",
        ),
        ({"verdict": "unknown", "effects": []}, None, "Something is missing that no effect of the library explains."),
        ({"verdict": "adequate", "effects": []}, {"ladder": [_ONE], "verdict": "adequate", "effects": []}, "Nothing is missing"),
        ({"verdict": "fit_failed", "effects": [], "why": "no start"}, None, "The model could not be fitted"),
        (None, None, "How well the model explains these records."),
        (
            None,
            {**REFINE, "effects": ["cubic_stiffness", "mains_hum", "adc_saturation"]},
            "What was missing: cubic stiffness, mains hum and ADC saturation.",
        ),
        (
            None,
            {**REFINE, "verdict": "class", "classes": [["cubic_stiffness", "electrostatic_softening"]]},
            "What was missing: cubic stiffness or electrostatic softening.",
        ),
        (
            None,
            {**REFINE, "verdict": "unknown", "left": "1.6 to 1.7 kHz"},
            "Cubic stiffness alone cannot account for it.",
        ),
    ],
)  # fmt: skip
def test_every_verdict_has_its_plain_sentence(diagnose: Any, refine: Any, said: str) -> None:
    assert said in _head(render_campaign_report("A17", COMPARE, diagnose, refine, [], None))


def test_an_unknown_misfit_is_never_headed_by_a_name() -> None:
    head = _head(render_campaign_report("A17", COMPARE, DIAGNOSE, {**REFINE, "verdict": "unknown"}, [], None))
    assert "What was missing" not in head
    assert "What is missing" not in head


def test_a_failed_fit_is_never_evidence() -> None:
    page = render_campaign_report("A17", {"fit_ok": False, "why": "no start converged"}, None, None, [], None)
    assert "nothing can be said" in _head(page)
    assert "no start converged" in _head(page)


def test_a_relative_error_stands_in_where_the_noise_is_not_known() -> None:
    compare = {"error": {"fit": None}, "relative_error": {"fit": 0.03}, "noise": {"sigma": None, "from": "residual"}}
    rungs = [
        {"effect": None, "status": None, "relative_error": 0.03},
        {"effect": "angular_rate", "status": "partial", "relative_error": 0.004},
    ]
    head = _head(
        render_campaign_report(
            "eq14", compare, None, {"ladder": rungs, "verdict": "adequate", "effects": ["angular_rate"]}, [], None
        )
    )
    assert "The relative error fell from 3.0 % to 0.4 % on the fitted records." in head
    assert "noise floor" not in head


def test_an_error_that_rises_is_not_said_to_fall() -> None:
    refine = copy.deepcopy(REFINE)
    refine["ladder"][1]["error_validate"] = 13.0
    head = _head(render_campaign_report("A17", COMPARE, None, refine, [], None))
    assert "fell" not in head
    assert "went from 12.3 to 13" in head


def test_an_effect_too_weak_for_the_error_is_told_by_chi2() -> None:
    refine = copy.deepcopy(REFINE)
    for rung in refine["ladder"]:
        rung |= {"error_validate": 1.001, "delta_chi2": 137.2 if rung["effect"] else None}
    head = _head(render_campaign_report("A17", COMPARE, None, refine, [], None))
    fell = 137.2 * sum(1 for rung in refine["ladder"] if rung["effect"] and rung["status"] != "refused")
    assert "stays at 1.00 on records the fit had not seen: beside the noise this is weak" in head
    assert f"χ² of the fitted records fell by {fell:.0f}." in head


def test_a_wrong_form_and_a_partial_rung_are_said_in_the_head() -> None:
    refine = copy.deepcopy(REFINE) | {"wrong_form": {"cubic_stiffness": {"by": "level", "log_p": -20.0}}}
    assert "the size of cubic stiffness disagrees between drive levels" in _head(
        render_campaign_report("A17", COMPARE, None, refine, [], None)
    )
    partial = copy.deepcopy(REFINE)
    partial["ladder"][1]["status"] = "partial"
    assert "Partial: cubic stiffness" in _head(render_campaign_report("A17", COMPARE, None, partial, [], None))


def test_theta_moves_by_the_turn_between_axes(page: str) -> None:
    # From 89.9 to -89.9 deg is a turn of 0.2 deg, 2 sd, not of 179.8 deg.
    assert re.search(r"89\.90 ± 0\.10 → −89\.90 ± 0\.10 deg\s*\(2\.0 sd\)", _head(page))


@pytest.mark.parametrize("of", ["compare", "diagnose", "refine"])
def test_any_key_may_be_absent_or_unknown(of: str) -> None:
    parts: dict[str, dict[str, Any]] = {"compare": COMPARE, "diagnose": DIAGNOSE, "refine": REFINE}
    for key in [*parts[of], None]:
        changed = copy.deepcopy(parts)
        if key is not None:
            del changed[of][key]
        changed[of]["an_unknown_key"] = {"x": [1]}
        for row in (*changed[of].get("ladder", ()), *changed[of].get("candidates", ()), *changed[of].get("where", ())):
            row.clear() if key is None else row.update(an_unknown_key=object())
        page = render_campaign_report("A17", changed["compare"], changed["diagnose"], changed["refine"], [], None)
        assert _Page(page).open == []


def test_numbers_that_are_none_or_nan_are_dashes() -> None:
    compare = copy.deepcopy(COMPARE) | {"parameters": {"f1_hz": [math.nan, None], "zeta1": [1e-4, None]}}
    diagnose = copy.deepcopy(DIAGNOSE)
    diagnose["candidates"][0] |= {"p_value": None, "error_after": math.inf, "estimate": {"f": [60.0, None]}}
    text = _Page(render_campaign_report("A17", compare, diagnose, None, BEFORE[:1], None)).text
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_names_from_outside_are_text() -> None:
    evil = '<script>alert("x")</script>&$x_{$'
    compare = copy.deepcopy(COMPARE)
    compare["where"][0]["record"] = evil
    diagnose = copy.deepcopy(DIAGNOSE) | {"effects": [evil]}
    diagnose["candidates"][0] |= {"effect": evil, "flag": evil}
    refine = copy.deepcopy(REFINE) | {"refused": {evil: evil}}
    refine["ladder"][1] |= {"effect": evil, "status": evil, "verdict": evil}
    record = RecordView(evil, "fit", RATE, *(getattr(BEFORE[0], f) for f in ("drive_v", "measured_v", "model_v")),
                        BEFORE[0].residual, BEFORE[0].error)  # fmt: skip
    page = render_campaign_report(
        evil, compare, diagnose, refine, [record], None, truth=evil, provenance={"a": evil},
        library={evil: {"law": evil, "signature": evil}}, verdicts={"before": evil},
    )  # fmt: skip
    assert "<script" not in page
    assert "script" not in _Page(page).tags
    assert "&lt;script&gt;" in page


def test_records_of_any_shape_are_drawn_or_left_out() -> None:
    one = RecordView("1 x 1", "fit", RATE, BEFORE[0].drive_v[:, :1], BEFORE[0].measured_v[:, :1],
                     BEFORE[0].model_v[:, :1], BEFORE[0].residual[:, :1], 9.0)  # fmt: skip
    silent = RecordView("silent", "fit", RATE, np.zeros((N, 1)), BEFORE[0].residual[:, :1] * SIGMA, np.zeros((N, 1)),
                        BEFORE[0].residual[:, :1], 1.0)  # fmt: skip
    short = RecordView("short", "fit", RATE, *(np.zeros((3, 1)) for _ in range(4)), 0.0)
    page = render_campaign_report("A17", {"error": {"fit": 9.0}}, None, None, [one, silent, short], None)
    assert "Residual over time and frequency" in page
    assert not re.search(r"\bnan\b", page)


# What the pictures show is what is there.


def test_white_noise_lies_on_the_floor_of_both_spectra() -> None:
    view = AFTER[0]
    assert sigma_v(view) == pytest.approx([SIGMA, SIGMA], rel=0.01)
    seen = spectra(view, (1000.0, 1900.0))
    # One padded bin of the rms over many: the amplitude of noise scatters, its mean square is the floor's.
    power = np.mean(np.abs(np.fft.rfft(view.residual * SIGMA, axis=0)[1500:2850] * 2 / N) ** 2)
    assert np.sqrt(power) == pytest.approx(float(seen.floor.mean()), rel=0.05)
    picture = time_frequency(view, 60, (0.0, 2000.0))
    assert 10 * np.log10(np.mean(10 ** (picture.over_noise_db / 10))) == pytest.approx(0.0, abs=0.15)


def test_a_tone_has_its_amplitude_in_the_spectrum() -> None:
    tone = 0.3 * np.sin(2 * np.pi * 400.0 * T)[:, None]
    view = RecordView("tone", "fit", RATE, tone, tone, 0.0 * tone, tone, 1.0)
    seen = spectra(view, (390.0, 410.0))
    assert seen.measured.max() == pytest.approx(0.3, rel=1e-3)
    assert seen.frequency_hz[seen.measured[:, 0].argmax()] == pytest.approx(400.0, abs=0.2)


def test_the_drive_is_drawn_where_it_is_and_its_harmonic_where_the_residual_is() -> None:
    times, drives = drive_frequency(BEFORE[0])
    assert drives.shape[0] == 2
    inner = slice(5, -5)
    slope = (500.0 - 300.0) / T[-1]
    np.testing.assert_allclose(drives[0][inner], 300.0 + slope * times[inner], atol=1.0)
    np.testing.assert_allclose(drives[1][inner], 500.0 - slope * times[inner], atol=1.0)
    picture = time_frequency(BEFORE[0], 60, (800.0, 2000.0))
    highest_drive_energy = np.unravel_index(picture.over_noise_db.argmax(), picture.over_noise_db.shape)
    at = picture.time_s[highest_drive_energy[1]]
    assert picture.frequency_hz[highest_drive_energy[0]] == pytest.approx(3 * (300.0 + slope * at), abs=60.0)


def test_a_multisine_has_no_instantaneous_frequency() -> None:
    random = np.random.default_rng(3)
    sines = sum(np.sin(2 * np.pi * (300.0 + k) * T + random.uniform(0, 6.28)) for k in range(100))
    view = RecordView("m", "fit", RATE, np.asarray(sines)[:, None], BEFORE[0].measured_v, BEFORE[0].model_v,
                      BEFORE[0].residual, 1.0)  # fmt: skip
    assert drive_frequency(view)[1].shape[0] == 0
    low, high = drive_band(view)
    assert 295.0 < low < 310.0 < 390.0 < high < 405.0


def test_a_cubic_residual_rises_as_the_third_power_of_the_level() -> None:
    level, residual = by_level(BEFORE[0], 0)
    excess = np.sqrt(np.maximum(residual**2 - 1.0, 0.0))
    high = level > 0.3
    slope = np.polyfit(np.log(level[high]), np.log(excess[high]), 1)[0]
    assert slope == pytest.approx(3.0, abs=0.25)
    # The smallest bins hold three blocks of twelve samples: sd 0.12.
    assert np.all(np.abs(by_level(AFTER[0], 0)[1] - 1.0) < 4 * 0.12)


def test_laws_are_typeset_and_units_come_from_the_library(page: str) -> None:
    from pipeline.device.effect import find_effects

    assert typeset("psi'' -= k3 |psi|^2 psi") == "ψ″ −= k3 |ψ|² ψ"
    assert effect_texts(find_effects())["cubic_stiffness"]["unit.k3"] == "1/(V^2 s^4)"
    assert "k3 = (1.2100 ± 0.0020)·10⁹ 1/(V² s⁴)" in _Page(page).text
    assert p_words(1e-200) == "< 10⁻⁹⁹"
    assert p_words(3e-5) == "3·10⁻⁵"
