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
    t, k = values.get("T", 0.0), values.get("k", 0.0)
    return np.asarray((values["a"] + t) * X + t**2 * X**2 + k * np.abs(X))


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


def _problem(t: float, k: float, seed: int, noise: float = 1.0) -> _Curved:
    random = np.random.default_rng(seed)
    truth = _model({"a": 2.0, "T": t, "k": k})
    blocks = tuple(ResidualBlock(name, truth + noise * random.standard_normal(truth.shape)) for name in ("fit", "held"))
    terms = (Term("delay", (TermParameter("T", side=1),)), Term("kink", (TermParameter("k"),)))
    # Cubes are the generic shape: neither term has them.
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
