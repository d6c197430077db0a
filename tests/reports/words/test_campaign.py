"""Each sentence states its fact for every case that the answers can have."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline.learning.answers import Noise, Place
from reports.words.campaign import (
    ErrorChange,
    change_sentence,
    class_sentence,
    effect_words,
    failure_sentence,
    missing_sentence,
    noise_sentence,
    partial_sentence,
    remaining_words,
    separating_sentence,
    wrong_form_sentence,
)
from reports.words.quantities import error_words, explained_words, p_words, place_words, typeset

HELD_OUT = "on the held-out records"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (ErrorChange(12.3, 1.0, HELD_OUT), "The error fell from 12.3 to 1.00 on the held-out records."),
        (ErrorChange(12.3, 13.0, HELD_OUT), "The error rose from 12.3 to 13.0 on the held-out records."),
        (
            ErrorChange(1.001, 1.001, HELD_OUT, delta_chi2=1372.2),
            "The error stays at 1.00 on the held-out records: the effect is small beside the noise. "
            "χ² on the fitted records fell by 1\u202f372.",
        ),
        (ErrorChange(1.001, 1.0, HELD_OUT), "The error stays at 1.00 on the held-out records."),
        (ErrorChange(1.5, None, HELD_OUT), "The error is 1.50 on the held-out records; 1.00 is the noise floor."),
        (
            ErrorChange(0.03, 0.004, HELD_OUT, relative=True),
            "The relative error fell from 3.0\u00a0% to 0.4\u00a0% on the held-out records.",
        ),
        (ErrorChange(0.03, None, HELD_OUT, relative=True), "The relative error is 3.0\u00a0% on the held-out records."),
        (ErrorChange(None, None, HELD_OUT), ""),
    ],
)
def test_the_change_of_the_error_is_stated(change: ErrorChange, text: str) -> None:
    assert change_sentence(change) == text


def test_the_misfit_is_the_excess_of_the_error_over_the_noise() -> None:
    assert ErrorChange(5.0**0.5, 0.99, HELD_OUT).misfit == pytest.approx((2.0, 0.0))
    assert ErrorChange(None, None, HELD_OUT).misfit == (None, None)


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        (Noise((0.001, 0.0012), "silent"), "σ = 1.00, 1.20 mV by channel, measured on the silent record."),
        (
            Noise((0.001,), "repeats"),
            "σ = 1.00 mV by channel, from the differences between repeats of a drive (there is no silent record).",
        ),
        (
            Noise((0.001,), "residual"),
            "The noise level could not be measured (no silent record, no repeats), so only relative errors are given. "
            "A smooth local fit leaves σ = 1.00 mV by channel.",
        ),
        (
            Noise((0.039, 0.039), "residual", "norm of each mode"),
            "The noise level could not be measured, so only relative errors are given. "
            "The misfit of the fit, 3.9\u00a0% of the norm of each mode, serves as the noise level in F-tests.",
        ),
        (
            Noise((0.01, 0.02), "declared", "norm of each mode"),
            "The record declares a noise level of 1.0\u00a0% and 2.0\u00a0% of the norm of each mode.",
        ),
        (None, "The noise level is not known, so only relative errors can be given."),
    ],
)
def test_the_noise_level_has_its_source(noise: Noise | None, text: str) -> None:
    assert noise_sentence(noise) == text


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({"kind": "line", "band_hz": (49.9, 50.1)}, "fixed line, 50 Hz"),
        ({"kind": "harmonic", "harmonic": 1}, "drive frequency"),
        ({"kind": "harmonic", "harmonic": 2, "record": "chirp"}, "2nd harmonic of the drive, chirp"),
        ({"kind": "broadband", "channel": "sense2"}, "broadband, sense 2"),
        ({"kind": "time", "family": "time", "time_s": (0.5, 1.0), "record": "a"}, "0.5 to 1 s, a"),
        ({"kind": "level", "family": "level", "level": 1.0}, "largest level"),
        ({"kind": "direction", "family": "direction", "direction": "up"}, "up"),
        ({"kind": "response", "family": "response", "channel": "sense1", "response_v": (0.1, 0.2)}, "sense 1, 0.1 to 0.2 V rms"),
        ({"kind": "resonance", "mode": 2, "band_hz": (536.0, 537.0), "channel": "sense1", "drive": "drive2"},
         "mode 2 (536.5 Hz), S1/D2"),
    ],
)  # fmt: skip
def test_a_place_has_its_kind_and_labels(place: dict[str, Any], text: str) -> None:
    empty: dict[str, Any] = {"record": None, "channel": None, "band_hz": None, "share": 1.0, "error": 2.0}
    assert place_words(Place(**{"family": "frequency"} | empty | place)) == text


@pytest.mark.parametrize(
    ("left", "text"),
    [
        ("agreement: cubic_stiffness by level", "the fitted size of cubic stiffness differs between drive levels"),
        ("repeat: a and b, rows 1 to 9", "a repeatable residual (a and b, rows 1 to 9)"),
        ("probe: x^3", "a residual that correlates with the response (x^3)"),
        ("region: band, a, sense1", "a residual above the noise in band, a, sense1"),
        ("line: line at 50.0 Hz", "an unmodelled line at 50.0 Hz"),
        ("1.6 to 1.7 kHz", "1.6 to 1.7 kHz"),
    ],
)
def test_the_structure_that_remains_is_named_by_its_test(left: str, text: str) -> None:
    assert remaining_words(left) == text


def test_classes_forms_and_failures_are_stated() -> None:
    assert class_sentence(("a", "b", "c")) == "These data cannot distinguish a, b and c."
    assert separating_sentence("drive.csv, SNR 12") == "This record would separate them: drive.csv, SNR 12."
    assert separating_sentence(None) == ""
    assert wrong_form_sentence("loop_delay", "direction") == (
        "The fitted size of loop delay differs between sweep directions: its law may have the wrong form."
    )
    assert partial_sentence(("a", "b"), held_out=False) == (
        "Partial: a and b are significant on the fitted records, but no record was held out to confirm them."
    )
    assert failure_sentence("") == "The fit failed: no reason was given."


def test_the_headline_of_an_unknown_misfit_names_no_effect() -> None:
    text = missing_sentence("unknown", ("cubic_stiffness", "mains_hum"), (), added=True)
    assert text == (
        "A misfit remains that no effect in the library explains. Cubic stiffness and mains hum do not remove it."
    )


def test_effects_that_imitate_a_missing_one_together_are_not_said_to_leave_a_misfit() -> None:
    names = ("cubic_stiffness", "hysteresis")
    text = missing_sentence("unknown", names, (), added=True, tried=names, imitating=names)
    assert "cubic stiffness and hysteresis remove the misfit together" in text
    assert "remains" not in text


def test_numbers_have_the_digits_that_matter() -> None:
    assert effect_words("offdiagonal_damping") == "off-diagonal damping"
    assert effect_words("tilt about the other axis (absorbed by updown_gain)").endswith("(absorbed by up-down gain)")
    assert [error_words(value) for value in (None, 1.0004, 12.34, 1234.5)] == ["–", "1.00", "12.3", "1\u202f234"]
    assert error_words(0.00123, relative=True) == "0.12\u00a0%"
    assert [explained_words(share) for share in (None, 0.99995, 1.0, -0.1)] == [
        "–",
        "> 99.99\u00a0%",
        "100\u00a0%",
        "−10.0\u00a0%",
    ]
    assert [p_words(p) for p in (1e-200, 9.6e-22, 3e-5, 0.25, None)] == ["< 10⁻⁹⁹", "1·10⁻²¹", "3·10⁻⁵", "0.25", "–"]


def test_laws_are_typeset_with_greek_letters_and_powers() -> None:
    assert typeset("psi'' -= k3 |psi|^2 psi") == "ψ″ −= k3 |ψ|² ψ"
