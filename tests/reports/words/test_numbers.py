"""Numbers in plain text are those that people write, and read back within the last digit."""

import math

import numpy as np
import pytest

from pipeline.learning.answers import RungAnswer
from reports.words.numbers import number, sd_text, volts, with_sd
from reports.words.support import support_words
from tests.reports.learning.conftest import _CUBIC


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (106840000000.0, 550000000.0, "1.0684e11 +- 5.5e8"),
        (534.50123, 0.0031, "534.5012 +- 0.0031"),
        (3.167e-4, 1e-9, "3.167000e-4 +- 1.0e-9"),
        (-33.2, 2.04, "-33.2 +- 2.0"),
        (12345.0, 678.0, "12340 +- 680"),
        (1234.0, 0.0996, "1234.00 +- 0.10"),
        (1.36e-5, 5.5e-6, "1.36e-5 +- 5.5e-6"),
        (-3.1e-7, 4.6e-6, "-3e-7 +- 4.6e-6"),
        (5e-7, 2e-3, "0.0000 +- 0.0020"),
        (0.0, 0.3, "0.00 +- 0.30"),
        (2.5, None, "2.5 +- ?"),
        (1e12, math.nan, "1e12 +- ?"),
    ],
)
def test_a_value_with_its_sd(value, sd, text):
    assert with_sd(value, sd) == text


def test_plain_numbers():
    assert [number(v) for v in (1e6, 123456.0, 0.25, 1.5e-7, None, -2e9)] == [
        "1e6",
        "123456",
        "0.25",
        "1.5e-7",
        "unknown",
        "-2e9",
    ]
    assert [sd_text(v) for v in (0.0996, 12.3, 0.0)] == ["0.10", "12", "0"]


def test_the_text_reads_back_within_the_sd():
    random = np.random.default_rng(2)
    for _ in range(2000):
        sd = 10.0 ** random.uniform(-12, 12)
        value = random.standard_normal() * sd * 10.0 ** random.uniform(-1, 6)
        shown, _, spread = with_sd(value, sd).partition(" +- ")
        assert float(spread) == pytest.approx(sd, rel=0.051)
        assert abs(float(shown) - value) <= 0.051 * sd + 1e-15 * abs(value)
        assert len(shown) < 24


def test_partial_says_how_strong_the_held_out_support_is():
    def rung(status, fall, sd):
        return RungAnswer(**{**_CUBIC, "status": status, "held_out_fall": fall, "held_out_sd": sd})

    assert support_words(rung("partial", 13.0, 10.0)) == "held out: 1.3 sd, 2 would confirm it"
    assert support_words(rung("partial", 130.0, 10.0)) == "held out: 13 sd, but the last model is not adequate"
    assert support_words(rung("confirmed", 90.0, 10.0)) == "held out: 9 sd"
    assert support_words(rung("partial", None, None)) == "nothing was held out"


def test_voltages_share_the_prefix_that_people_would_write() -> None:
    assert volts([0.0124, 0.0194]) == "12.4, 19.4 mV"
    assert volts([237.0, 0.5]) == "237, 0.500 V"
    assert volts([3.4e-7]) == "340 nV"
    assert volts([0.0]) == "0 V"
