"""Terms whose first order the baseline absorbs: only a refit from a size that is not null shows them.

y = a x + T x + T^2 x^2 + noise      a: baseline;  T: a term whose column at T = 0 is x, the same as that of a
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.criticism.problem import FitResult, ResidualBlock, Signatures, TermParameter
from pipeline.criticism.regression import Regression, Term
from pipeline.criticism.selection import forward_selection

X = np.linspace(-1.0, 1.0, 2000)[:, None]
START = 3.0


def _model(values: Mapping[str, float]) -> FloatArray:
    t, k, w = (values.get(name, 0.0) for name in ("T", "k", "w"))
    return np.asarray((values["a"] + t) * X + t**2 * X**2 + k * np.abs(X) + w * np.sin(9.0 * X))


def _predict(points: Sequence[Mapping[str, float]]) -> list[list[FloatArray]]:
    return [[_model(point), _model(point)] for point in points]


@dataclass(frozen=True, eq=False)
class _Curved(Regression):
    """The regression, which states that "delay" is curved and starts it at a size that is not null."""

    beside: frozenset[str] = frozenset()

    def signatures(self, fit: FitResult) -> Signatures:
        return replace(super().signatures(fit), curved=frozenset({"delay"}), beside=self.beside)

    def fit(self, terms: tuple[str, ...], start: FitResult | None = None) -> FitResult:
        if start is not None and "delay" in terms and "T" not in start.parameters:
            start = replace(start, parameters={**start.parameters, "T": (START, 0.0)})
        return super().fit(terms, start)


def _problem(t: float, k: float, seed: int, noise: float = 1.0, wave: float = 0.0, cube: float = 0.0) -> _Curved:
    random = np.random.default_rng(seed)
    truth = _model({"a": 2.0, "T": t, "k": k, "w": wave}) + cube * X**3
    blocks = tuple(ResidualBlock(name, truth + noise * random.standard_normal(truth.shape)) for name in ("fit", "held"))
    others = (Term("kink", (TermParameter("k"),)), Term("wave", (TermParameter("w"),)))
    terms = (Term("delay", (TermParameter("T", side=1),)), *others)
    # Cubes are the generic shape: no term has them.
    return _Curved(_predict, blocks, {"a": 0.0}, terms, held=1, probe={"square": (X**2,), "cube": (X**3,)})


def test_a_term_is_found_by_its_second_order_where_the_baseline_absorbs_the_first() -> None:
    selection = forward_selection(_problem(2.0, 0.0, 1))
    assert selection.added == ("delay",)
    value, sd = selection.last.fit.parameters["T"]
    assert abs(value - 2.0) < 4.0 * sd


def test_a_curved_term_is_not_added_where_another_effect_or_none_is_hidden() -> None:
    assert forward_selection(_problem(0.0, 0.0, 2)).added == ()
    assert forward_selection(_problem(0.0, 4.0, 3)).added == ("kink",)


@pytest.mark.parametrize(("t", "added"), [(0.0, ()), (0.4, ("delay",))])
def test_a_term_beside_which_the_records_were_corrected_is_refitted_though_too_large_a_noise_hides_its_structure(
    t: float, added: tuple[str, ...]
) -> None:
    # The noise is half as large as the problem assumes.
    problem = _problem(t, 0.0, 4, 0.5)
    assert "delay" not in forward_selection(problem).added
    assert forward_selection(replace(problem, beside=frozenset({"delay"}))).added == added


def test_a_curved_term_that_explained_too_little_beside_a_larger_effect_is_refitted_after_it_and_added() -> None:
    # The delay lowers chi2 by 2000 of 10 million.
    assert set(forward_selection(_problem(1.5, 0.0, 5, wave=100.0)).added) == {"wave", "delay"}


def test_a_curved_term_that_gained_nothing_is_not_refitted_after_another_effect_though_structure_is_left() -> None:
    selection = forward_selection(_problem(0.0, 0.0, 6, wave=100.0, cube=20.0))
    assert selection.last.is_structured(0.003)
    assert frozenset({"delay"}) in selection.fits
    assert frozenset({"wave", "delay"}) not in selection.fits
