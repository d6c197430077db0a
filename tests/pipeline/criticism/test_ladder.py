"""Diagnosis and ladder of a problem without gyros: hidden terms are found, look-alikes form a class, noise names no term."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.criticism.fit_tests import Rules, wald
from pipeline.criticism.held_out import PairedDifference
from pipeline.criticism.ladder import as_diagnosis, as_ladder, diagnose, refine
from pipeline.criticism.selection import forward_selection
from pipeline.criticism.verdict import is_supported

RULES = Rules(draws=2000)
X, SCALE_HELD_OUT = np.linspace(-1.0, 1.0, 400), 0.8


def _outcomes(count: int, problem: Callable[[int], Any], *hidden: str) -> Counter[str]:
    """How many diagnoses are "right", "class" (classes hold exactly the hidden terms), "wrong", or else have which verdict."""
    outcomes: Counter[str] = Counter()
    for seed in range(count):
        diagnosis = diagnose(problem(seed), rules=RULES)
        if not diagnosis.terms:
            outcomes["right" if diagnosis.verdict == "adequate" and not hidden else diagnosis.verdict] += 1
            continue
        held = [any(name in item.members for item in diagnosis.classes) for name in hidden]
        in_classes = len(diagnosis.classes) == len(hidden) and all(held)
        alone = diagnosis.verdict == "effect" and set(diagnosis.terms) == set(hidden)
        outcomes["right" if alone else "class" if in_classes else "wrong"] += 1
    return outcomes


def test_no_term_is_named_where_none_is_hidden(toy: Any) -> None:
    found = _outcomes(60, toy.problem)
    # 0.3 % family-wise: two or more names in 60 would have probability 0.01.
    assert found["wrong"] <= 1
    assert found["unknown"] <= 2


@pytest.mark.parametrize(
    "noise",
    [
        lambda rng, block, n: 1.2 * rng.standard_normal(n),
        lambda rng, block, n: rng.standard_t(3.0, n) / np.sqrt(3.0),
        lambda rng, block, n: rng.standard_normal(n) * np.repeat([0.7, 1.6, 1.0, 1.1], n // 4),
    ],
    ids=["stronger", "heavy-tailed", "coloured"],
)
def test_noise_that_differs_from_its_model_names_no_term(toy: Any, noise: Any) -> None:
    strata = tuple(np.repeat(np.arange(4), 100) for _ in range(4))
    found = _outcomes(30, lambda seed: toy.problem(seed, noise=noise, strata=strata))
    assert found["wrong"] <= 2


@pytest.mark.parametrize("term", ["square", "cube", "kink", "bump", "line"])
def test_a_hidden_term_is_named_more_often_at_higher_snr(toy: Any, term: str) -> None:
    right = []
    for snr in (2.0, 6.0, 60.0):
        hidden = {term: snr}
        found = _outcomes(8, lambda seed, hidden=hidden: toy.problem(seed, hidden), term)
        assert found["wrong"] == 0
        right.append(found["right"] + found["class"])
    assert right[0] <= right[1] <= right[2] == 8
    assert found["right"] == 8


def test_look_alikes_are_one_class_below_the_snr_needed_to_tell_them_apart(toy: Any) -> None:
    library = ("square", "cube", "cube_like", "kink", "line")
    near = diagnose(toy.problem(1, {"cube": 30.0}, library=library), rules=RULES)
    assert near.verdict == "class"
    assert set(near.classes[0].members) == {"cube", "cube_like"}
    rival = next(r for r in near.classes[0].rivals if r.name in ("cube", "cube_like"))
    assert rival.snr_needed == pytest.approx(5.0 / rival.sin_angle)
    far = diagnose(toy.problem(1, {"cube": 2.0 * rival.snr_needed}, library=library), rules=RULES)
    assert (far.verdict, far.terms) == ("effect", ("cube",))


def test_a_term_outside_the_library_gives_unknown_and_no_confirmed_rung(toy: Any) -> None:
    for seed in range(5):
        problem = toy.problem(seed, {"outside": 25.0})
        assert diagnose(problem, rules=RULES).verdict == "unknown"
        ladder = refine(problem, rules=RULES)
        assert (ladder.verdict, ladder.imitating) == ("unknown", ())
        assert all(rung.status != "confirmed" for rung in ladder.rungs)


def test_two_hidden_terms_are_found_and_the_error_falls_to_one(toy: Any) -> None:
    ladder = refine(toy.problem(3, {"cube": 60.0, "line": 40.0}), rules=RULES)
    assert set(ladder.terms) == {"cube", "line"}
    assert ladder.verdict == "adequate"
    errors = [rung.error_fit for rung in ladder.rungs]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * 1600))
    assert ladder.rungs[-1].error_validate == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * 400))
    assert ladder.rungs[-1].explained == pytest.approx(1.0, abs=0.05)
    assert [rung.status for rung in ladder.rungs] == [None, "confirmed", "confirmed"]


def test_terms_that_imitate_a_third_one_together_are_not_named(toy: Any) -> None:
    library = ("square", "left", "right")
    for seed in range(4):
        ladder = refine(toy.problem(seed, {"sum": 60.0}, library=library), rules=RULES)
        assert {rung.term for rung in ladder.rungs} == {None, "left", "right"}
        assert ladder.rungs[2].delta_chi2 > 2.0 * ladder.rungs[1].delta_chi2
        assert ladder.verdict == "unknown"
        assert set(ladder.imitating) == {"left", "right"}
        assert all(rung.status != "confirmed" for rung in ladder.rungs)
        both = diagnose(toy.problem(seed, {"left": 60.0, "right": 30.0}, library=library), rules=RULES)
        assert (both.verdict, set(both.terms), both.imitating) == ("effect", {"left", "right"}, ())


@pytest.mark.parametrize(("snr", "supported"), [(30.0, True), (6.0, False)])
def test_a_term_without_a_wald_statistic_is_supported_by_what_chi2_rises_without_it(
    toy: Any, snr: float, supported: bool
) -> None:
    problem = toy.problem(3, {"cube": 60.0, "bump": snr}, library=("cube", "bump"), levels=("bump",))
    found = forward_selection(problem, rules=RULES)
    assert set(found.added) == {"cube", "bump"}
    # Held-out records that hardly clip confirm nothing.
    quiet = replace(found, steps=tuple(replace(step, held=PairedDifference(1.0, 1.0)) for step in found.steps))
    assert wald(quiet.last.fit, "bump") == 0.0
    assert is_supported(quiet, "bump") == supported
    assert is_supported(quiet, "cube")


def test_a_superfluous_term_is_removed_once_the_right_one_is_added(toy: Any) -> None:
    ladder = refine(toy.problem(4, {"cube": 80.0}), terms=("bump",), rules=RULES)
    assert ladder.terms == ("cube",)
    assert ladder.rungs[-1].dropped == ("bump",)


def test_a_term_whose_size_differs_between_blocks_is_reported_with_its_deviations(toy: Any) -> None:
    ladder = refine(toy.problem(5, {"bump": 60.0}, factors=(1.0, 1.0, 0.7, 0.6, 0.85)), rules=RULES)
    assert ladder.verdict == "unknown"
    assert "bump" in ladder.wrong_form
    found = ladder.wrong_form["bump"]
    assert found.log_p < np.log(1e-6)
    # Blocks at full strength lie above the common size, the weakest below it.
    by_part = {part: deviation for part, (deviation, _) in found.sizes.items()}
    assert min(by_part, key=lambda part: by_part[part]).endswith(("b2", "b3", "0.35", "0.6"))
    assert max(by_part.values()) > 0.0 > min(by_part.values())


def test_a_term_that_held_out_data_contradict_is_refused(toy: Any) -> None:
    # The held-out block has the term with the opposite sign, so the fit predicts it wrongly.
    problem = toy.problem(6, {"line": 40.0})
    data = [*problem.data[:-1], 2.0 * (1.0 + 2.0 * SCALE_HELD_OUT * X) - problem.data[-1]]
    ladder = refine(type(problem)(tuple(data)), rules=RULES)
    assert "line" in ladder.refused
    assert "line" not in ladder.terms
    assert ladder.verdict == "unknown"


def test_a_failed_fit_is_not_evidence_for_its_term(toy: Any) -> None:
    found = diagnose(toy.problem(7, {"cube": 50.0}, fails=("cube",), library=("cube",)), rules=RULES)
    assert found.verdict == "fit_failed"
    assert found.terms == ()
    assert "cube" in found.why


def test_a_failed_fit_that_promises_the_remaining_misfit_is_named_instead_of_unknown(toy: Any) -> None:
    hidden = {"bump": 200.0, "cube": 50.0}
    found = refine(toy.problem(7, hidden, fails=("cube",), library=("bump", "cube")), rules=RULES)
    assert found.terms == ("bump",)
    assert (found.verdict, found.rungs[-1].status) == ("fit_failed", "partial")
    assert "cube: its fit failed" in found.why
    assert "failed" in found.refused["cube"]


def test_a_failed_fit_that_promises_less_than_the_remaining_misfit_leaves_unknown(toy: Any) -> None:
    hidden = {"bump": 200.0, "cube": 50.0}
    found = refine(toy.problem(7, hidden, fails=("bump",), library=("bump", "cube")), rules=RULES)
    assert found.verdict == "fit_failed"
    assert "bump" in found.why
    weak = refine(toy.problem(7, hidden, fails=("square",), library=("square", "cube")), rules=RULES)
    assert weak.verdict == "unknown"


def test_judging_a_selection_does_not_change_it(toy: Any) -> None:
    problem = toy.problem(1, {"cube": 30.0}, library=("square", "cube", "cube_like", "kink", "line"))
    selection = forward_selection(problem, rules=RULES)
    fits = dict(selection.fits)
    assert as_ladder(problem, selection, RULES).verdict == "class"
    assert as_diagnosis(problem, selection, RULES).verdict == "class"
    assert selection.fits == fits


def test_nothing_is_refitted_beside_a_term_that_leaves_nothing_and_its_class_is_found_all_the_same(toy: Any) -> None:
    problem = toy.problem(1, {"cube": 30.0}, library=("square", "cube", "cube_like", "kink", "line"))
    selection = forward_selection(problem, rules=RULES)
    assert selection.added in (("cube",), ("cube_like",))
    # Both promise the same, and neither can exceed the other.
    assert len(selection.fits) == 2
    assert set(as_ladder(problem, selection, RULES).classes[0].members) == {"cube", "cube_like"}


def test_a_ladder_that_ends_after_the_most_effects_says_which_significant_one_it_did_not_try(toy: Any) -> None:
    hidden = {"square": 20.0, "cube": 20.0, "bump": 20.0}
    problem = toy.problem(1, hidden)
    whole, short = forward_selection(problem, rules=RULES), forward_selection(problem, rules=replace(RULES, rungs=2))
    assert set(whole.added) == set(hidden)
    assert whole.not_tried == ()
    assert set(hidden) - set(short.added) <= set(short.not_tried)
    assert not set(short.added) & set(short.not_tried)
