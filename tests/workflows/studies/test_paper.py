"""The page of the paper: every printed number is reproduced, or a remark explains the difference."""

import re
from pathlib import Path

import numpy as np
import pytest

from reports.paper.content import PaperContent, PrintedNumber
from reports.paper.page import deviation, ours, printed
from workflows.studies.paper.devices import StudySizes
from workflows.studies.paper.page import write_paper

SMALL = StudySizes(orders=(20, 40), splits_hz=(0.1, 1.9), shares=(0.0, 0.5), noises=4)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PaperContent]:
    path, content, _ = write_paper(tmp_path_factory.mktemp("paper"), SMALL)
    return path, content


def test_every_printed_number_is_consistent_or_has_a_remark(page: tuple[Path, PaperContent]) -> None:
    for row in page[1].numbers:
        assert row.consistent or row.remark, row
        assert np.isfinite(row.compared), row


def test_only_the_known_exceptions_are_inconsistent(page: tuple[Path, PaperContent]) -> None:
    wrong = {row.name for row in page[1].numbers if not row.consistent}
    of_eq14 = {name for name in wrong if name.startswith(("R0", "R1", "frequency of", "damping ratio of"))}
    assert "R0 of mode 3, S1/D2" in of_eq14
    # Three standard deviations of four records: one of thirty may lie outside.
    assert len(of_eq14) <= 3
    assert wrong - of_eq14 == {
        "M2, S2/D1",
        "condition of M3",
        *(f"Hankel value {k}" for k in range(1, 9)),
        *(f"vibrometer, mode {k}" for k in (1, 2, 3)),
        "ε1 at 1.90 Hz, √(c11 c22)",
        "a11/a21 at 1.90 Hz, √(c11 c22)",
        "ε1 at 0.95 Hz, c22",
    }


def test_the_four_thetas_from_eq_14_and_from_a_record_of_it_agree_with_the_print(
    page: tuple[Path, PaperContent],
) -> None:
    rows = page[1].groups["theta"].rows[:4]
    assert [row.printed for row in rows] == ["-30.76", "-36.44", "-33.40", "-32.31"]
    for row in rows:
        assert abs(row.ours - row.value) < 0.0075
        assert abs(row.record - row.value) < 0.03


def test_at_a_small_split_c12_biases_theta_of_the_route_but_not_of_the_fit(page: tuple[Path, PaperContent]) -> None:
    steps = page[1].steps
    assert steps.route_deg[1, 0] > 10.0
    assert steps.route_deg[1, 0] == pytest.approx(steps.limit_deg[1, 0], rel=0.05)
    assert np.all(steps.fit_deg < 5.0 * steps.sd_deg)


def test_the_simulated_loops_agree_with_the_corrected_equations(page: tuple[Path, PaperContent]) -> None:
    for row in page[1].biases:
        assert row.loops == pytest.approx(row.corrected, rel=0.01)
    wrong = [row.equation for row in page[1].biases if row.printed != pytest.approx(row.corrected, rel=0.01)]
    assert wrong == ["(4), (5)", "(5)", "(6)"]


def test_the_page_is_self_contained(page: tuple[Path, PaperContent]) -> None:
    text = page[0].read_text(encoding="utf-8")
    assert text.lower().startswith("<!doctype html>")
    assert text.count("<svg") == 7
    assert not re.search(r"(?:src|href)\s*=\s*[\"'](?!#)", text)
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.S).lower().split()


@pytest.mark.parametrize(
    ("number", "texts"),
    [
        (PrintedNumber("", "", "57.27", 57.2764), ("57.27", "57.276", "+0.0064")),
        (PrintedNumber("", "", "3.167e-4", 3.1654e-4), ("3.167·10⁻⁴", "3.1654·10⁻⁴", "−1.6·10⁻⁷")),
        (PrintedNumber("", "", "400", 408.07, relation=">"), ("> 400", "408.1", "holds")),
        (PrintedNumber("", "", "-64740", 64740.0), ("−64740", "64740.0", "+129480")),
    ],
)
def test_numbers_are_shown_with_one_digit_more_than_the_print(number: PrintedNumber, texts: tuple[str, ...]) -> None:
    assert (printed(number), ours(number.compared, number), deviation(number)) == texts


def test_agreement_is_half_a_unit_of_the_last_printed_digit() -> None:
    assert PrintedNumber("", "", "11.70e-4", 11.7049e-4).agrees
    assert not PrintedNumber("", "", "11.70e-4", 11.7051e-4).agrees
    assert PrintedNumber("", "", "11.70e-4", 11.7051e-4, spread=2e-8).consistent
    assert not PrintedNumber("", "", "6", 6.5, relation="<").agrees
