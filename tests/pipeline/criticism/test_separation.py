"""The predicted SNR equals the difference of refits to old and new rows, and never exceeds its upper bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.criticism.problem import FitResult, ResidualBlock
from pipeline.criticism.separation import Prediction, known_of, separation, snr

OLD, NEW = 60, 40


def columns(rng, rows):
    """Two baseline columns and term a or b; the terms are nearly equal on the old rows and differ on the new ones."""
    base = rng.standard_normal((rows, 2))
    a = rng.standard_normal((rows, 1))
    b = a + (0.05 if rows == OLD else 1.0) * rng.standard_normal((rows, 1))
    return {"a": np.concatenate([base, a], axis=1), "b": np.concatenate([base, b], axis=1)}


def fitted(y, design):
    size = np.linalg.lstsq(design, y, rcond=None)[0]
    return size, float(np.sum((y - design @ size) ** 2))


def predictions(seed, scale=(1.0, 1.0, 1.0)):
    rng = np.random.default_rng(seed)
    old, new = columns(rng, OLD), columns(rng, NEW)
    truth = np.array([1.0, -2.0, 3.0])
    y = old["a"] @ truth + rng.standard_normal(OLD)
    found = {}
    for term in ("a", "b"):
        size, chi2 = fitted(y, old[term])
        jacobian = old[term] * np.array(scale)
        fit = FitResult(True, (term,), {}, (ResidualBlock("old", (y - old[term] @ size)[:, None]),), (jacobian,))
        found[term] = Prediction(term, new[term] @ size, chi2, known_of(fit), new[term] * np.array(scale))
    return y, old, new, found


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_the_snr_is_the_difference_of_the_refits_on_old_and_new_rows(seed):
    y, old, new, found = predictions(seed)
    for right, wrong in (("a", "b"), ("b", "a")):
        whole = np.concatenate([y, found[right].signal])
        chi2 = {t: fitted(whole, np.concatenate([old[t], new[t]]))[1] for t in ("a", "b")}
        # The new rows are the right fit's own prediction, so its refit does not change it.
        assert chi2[right] == pytest.approx(found[right].chi2)
        predicted = snr(found[right], found[wrong])
        assert np.sign(predicted) * predicted**2 == pytest.approx(chi2[wrong] - chi2[right], rel=1e-6, abs=1e-6)


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_the_snr_does_not_depend_on_parameter_units_and_never_exceeds_its_bound(seed):
    plain, scaled = predictions(seed)[3], predictions(seed, (1e6, 1.0, 1e-7))[3]
    found = separation(tuple(plain.values()))
    assert separation(tuple(scaled.values())).least == pytest.approx(found.least, rel=1e-6, abs=1e-5)
    bounds = [Prediction(p.term, p.signal, p.chi2, p.known) for p in plain.values()]
    assert separation(bounds).least >= found.least - 1e-9


def test_a_term_and_its_special_case_have_no_separation():
    rng = np.random.default_rng(4)
    wide_old, wide_new = rng.standard_normal((OLD, 3)), 100.0 * rng.standard_normal((NEW, 3))
    y = wide_old[:, :2] @ np.array([5.0, 7.0]) + rng.standard_normal(OLD)
    found = []
    for term, count in (("special", 2), ("general", 3)):
        size, chi2 = fitted(y, wide_old[:, :count])
        fit = FitResult(True, (term,), {}, (), (wide_old[:, :count],))
        found.append(Prediction(term, wide_new[:, :count] @ size, chi2, known_of(fit), wide_new[:, :count]))
    assert snr(found[1], found[0]) > 20.0
    assert separation(found).least == pytest.approx(0.0, abs=0.05)


def test_pairs_are_sorted_by_snr():
    signals = {"a": 0.0, "b": 1.0, "c": 5.0}
    eye = np.zeros((1, 1))
    found = separation([Prediction(t, np.full(4, s), 0.0, eye, np.zeros((4, 1))) for t, s in signals.items()])
    assert [pair for pair, _ in found.pairs] == [("a", "b"), ("b", "c"), ("a", "c")]
    assert found.least == pytest.approx(2.0)
    assert found.apart(5.0) == 2
