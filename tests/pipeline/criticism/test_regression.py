"""Terms are selected for any function: with an unknown frequency, and with an unknown noise level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.criticism.fit_tests import Rules
from pipeline.criticism.ladder import diagnose, refine
from pipeline.criticism.problem import ResidualBlock, TermParameter
from pipeline.criticism.regression import Regression, Term

T = np.linspace(0.0, 1.0, 150)
LEVELS = (1.0, 0.5, 0.8)
RULES = Rules(draws=2000)


def _predict(p: Mapping[str, float]) -> list[FloatArray]:
    """A decay with optional saturation, a line of unknown frequency, and an offset that is never negative."""
    out = []
    for level in LEVELS:
        y = level * p["a"] * np.exp(-p["rate"] * T)
        y = y / (1.0 + p["saturation"] * y)
        y = y + p["cos"] * np.cos(p["f"] * T) + p["sin"] * np.sin(p["f"] * T) + p["floor"] * np.sqrt(T)
        out.append(y[:, None])
    return out


TERMS = (
    Term("saturation", (TermParameter("saturation", "1", reach=1.0),)),
    Term("line", (TermParameter("cos"), TermParameter("sin")), {"f": tuple(np.arange(20.0, 80.0, 2.0))}),
    Term("floor", (TermParameter("floor", side=1),)),
)
NULL = {"saturation": 0.0, "cos": 0.0, "sin": 0.0, "f": 20.0, "floor": 0.0}


def _problem(seed: int, noise_known: bool = True, scale: float = 1.0, **truth: float) -> Regression:
    rng = np.random.default_rng(seed)
    clean = _predict({"a": 20.0, "rate": 3.0, **NULL, **truth})
    measured = tuple(
        ResidualBlock(f"b{i}", (y + rng.standard_normal(y.shape)) * scale, {"level": str(level)})
        for i, (y, level) in enumerate(zip(clean, LEVELS))
    )
    return Regression(
        lambda points: [[scale * y for y in _predict(p)] for p in points],
        measured,
        {"a": 15.0, "rate": 2.0},
        TERMS,
        held=1,
        noise_known=noise_known,
    )


def test_a_line_of_unknown_frequency_is_found_at_its_frequency() -> None:
    ladder = refine(_problem(1, cos=1.5, f=47.3), rules=RULES)
    assert (ladder.verdict, ladder.terms) == ("adequate", ("line",))
    value, sd = ladder.rungs[-1].parameters["f"]
    assert abs(value - 47.3) < 4.0 * sd < 2.0
    assert ladder.rungs[-1].status == "confirmed"


def test_a_nonlinear_term_is_found_with_its_size_and_sign() -> None:
    ladder = refine(_problem(2, saturation=0.05), rules=RULES)
    assert ladder.terms == ("saturation",)
    value, sd = ladder.rungs[-1].parameters["saturation"]
    assert abs(value - 0.05) < 4.0 * sd
    assert value > 5.0 * sd


def test_with_an_unknown_noise_level_the_term_is_found_and_no_error_is_given() -> None:
    found = diagnose(_problem(3, noise_known=False, scale=1e-3, cos=2.0, f=33.0), rules=RULES)
    assert (found.verdict, found.terms) == ("effect", ("line",))
    assert (found.fit.error_of("fit"), found.fit.error_of("validate")) == (None, None)
    nothing = diagnose(_problem(4, noise_known=False, scale=1e3), rules=RULES)
    assert (nothing.verdict, nothing.terms) == ("adequate", ())


def test_the_baseline_parameters_are_estimated_within_their_sd() -> None:
    fit = _problem(5).fit(())
    assert fit.ok
    for name, truth in (("a", 20.0), ("rate", 3.0)):
        value, sd = fit.parameters[name]
        assert abs(value - truth) < 4.0 * sd
    assert fit.chi2 == pytest.approx(fit.dof, abs=4.0 * np.sqrt(2.0 * fit.dof))


_SLOPE = np.linspace(-1.0, 1.0, 20)[:, None]


def test_a_fit_stays_within_its_limits_and_fits_the_other_parameters() -> None:
    def predict(points: Sequence[Mapping[str, float]]) -> list[list[FloatArray]]:
        return [[p["a"] + p["b"] * _SLOPE] for p in points]

    fit = Regression(
        predict, (ResidualBlock("y", 1.0 + 2.0 * _SLOPE),), {"a": 0.2, "b": 0.0}, (), limits={"a": (-5.0, 0.4)}
    ).fit(())
    assert fit.ok
    assert fit.parameters["a"][0] == pytest.approx(0.4, abs=1e-6)
    assert fit.parameters["b"][0] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("unit", [1.0, 1e-4])
def test_with_an_unknown_noise_level_the_selection_does_not_depend_on_units(unit: float) -> None:
    """A needed term is kept, however small the numbers are."""
    rng = np.random.default_rng(6)
    truth = _SLOPE + 0.3 * _SLOPE**2 + 0.2 * _SLOPE**3 + 0.02 * rng.standard_normal(_SLOPE.shape)

    def predict(points: Sequence[Mapping[str, float]]) -> list[list[FloatArray]]:
        return [[unit * (p["a"] * _SLOPE + p["square"] * _SLOPE**2 + p["cube"] * _SLOPE**3)] for p in points]

    terms = (Term("square", (TermParameter("square"),)), Term("cube", (TermParameter("cube"),)))
    problem = Regression(predict, (ResidualBlock("y", unit * truth),), {"a": 1.0}, terms, noise_known=False)
    assert set(refine(problem, rules=Rules(alpha=0.05, draws=2000)).terms) == {"square", "cube"}
