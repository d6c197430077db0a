"""Answers from criticism as JSON: the keys of the contract are there, and the same problem gives the same answer."""

from __future__ import annotations

import json
from typing import Any

from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import diagnose, refine
from pipeline.learning.answers import to_json
from pipeline.learning.common import diagnosis_answer, refinement_answer

RULES = Rules(draws=2000)


def test_answers_are_json_with_the_keys_of_the_contract(toy: Any) -> None:
    problem = toy.problem(2, {"square": 20.0})
    diagnosis = json.loads(to_json(diagnosis_answer(diagnose(problem, rules=RULES))))
    refinement = json.loads(to_json(refinement_answer(refine(problem, rules=RULES))))
    assert {"verdict", "effects", "candidates", "classes", "invisible", "error"} <= set(diagnosis)
    assert {"effect", "delta_chi2", "p_value", "estimate", "error_after", "class"} <= set(diagnosis["candidates"][0])
    rung = {
        "effect",
        "status",
        "error_fit",
        "error_validate",
        "misfit_fit",
        "misfit_validate",
        "relative_error",
        "delta_chi2",
    }
    assert rung <= set(refinement["ladder"][0])


def test_the_same_problem_gives_the_same_diagnosis(toy: Any) -> None:
    problem = toy.problem(2, {"square": 6.0})
    first, second = (to_json(diagnosis_answer(diagnose(problem, rules=RULES))) for _ in range(2))
    assert first == second
