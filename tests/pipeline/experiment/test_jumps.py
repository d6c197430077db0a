"""Rows beside a jump of a stepped sweep: a linear resonance has none, a Duffing resonance has those of its folds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.arrays import BoolArray, ComplexArray, FloatArray
from pipeline.experiment.jumps import jump_rows, jumps_of
from pipeline.experiment.tones import ToneRecord, passes_of

F0, ZETA = 1000.0, 0.005
WIDTH = ZETA * F0


def sweep(f: FloatArray, y: ComplexArray, sd: float) -> tuple[ToneRecord, FloatArray]:
    record = ToneRecord("sweep", "sweep", f, np.ones((f.size, 1)) + 0.0j, y[:, None])
    return record, np.full((f.size, 1), sd)


def jumping(record: ToneRecord, sd: FloatArray) -> BoolArray:
    (one,) = passes_of((record,))
    return jump_rows(record, one, WIDTH, sd)


@settings(deadline=None, max_examples=200)
@given(
    step=st.floats(0.02, 6.0),
    offset=st.floats(-0.5, 0.5),
    background=st.complex_numbers(max_magnitude=0.3),
    seed=st.integers(0, 1000),
)
def test_no_row_of_a_linear_resonance_is_a_jump_at_any_step(
    step: float, offset: float, background: complex, seed: int
) -> None:
    rows = int(min(max(24.0 / step, 8.0), 600.0))
    f = F0 + WIDTH * step * (np.arange(rows) - rows / 2 + offset)
    y = 1.0 / (1.0 + 1.0j * (f - F0) / WIDTH) + background
    noise = np.random.default_rng(seed).standard_normal((2, rows)) * 1e-3
    assert not jumping(*sweep(f, y + noise[0] + 1.0j * noise[1], 1e-3)).any()


def duffing(f: FloatArray, bend: float) -> ComplexArray:
    """a (1 + i (x - bend |a|^2)) = 1 at x = (f - f0) / (zeta f0), on the branch of the row before (slow motion, first order)."""
    found, last = np.zeros(f.size, dtype=np.complex128), 0.0
    for k, x in enumerate((f - F0) / WIDTH):
        # |a|^2 = s:  s (1 + (x - bend s)^2) = 1
        roots = np.roots([bend**2, -2.0 * x * bend, 1.0 + x**2, -1.0])
        real = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
        stable = real[[0, -1]] if real.size > 1 else real
        last = float(stable[np.argmin(np.abs(stable - last))])
        found[k] = 1.0 / (1.0 + 1.0j * (x - bend * last))
    return found


@pytest.mark.parametrize("up", [True, False], ids=["up", "down"])
def test_the_rows_on_both_sides_of_a_fold_are_jumps_and_no_others(up: bool) -> None:
    f = F0 + WIDTH * np.linspace(-6.0, 12.0, 61)
    f = f if up else f[::-1]
    y = duffing(f, 5.0)
    fold = int(np.argmax(np.abs(np.diff(y))))
    record, sd = sweep(f, y, 1e-4)
    left_out = jumping(record, sd)
    assert np.flatnonzero(left_out).tolist() == [fold, fold + 1]
    (one,) = passes_of((record,))
    (jump,) = jumps_of(record, one, left_out)
    assert (jump.record, jump.rows) == ("sweep", 2)
    assert {jump.first_hz, jump.last_hz} == set(f[left_out])


def test_a_pass_that_moves_fast_nearly_everywhere_keeps_its_rows() -> None:
    """Such as behind a long cable, where the bound of a resonance does not hold."""
    f = F0 + WIDTH * np.linspace(-6.0, 6.0, 61)
    record, sd = sweep(f, np.exp(1.0j * np.arange(61)), 1e-4)
    assert not jumping(record, sd).any()


def test_a_frequency_response_has_no_jumps() -> None:
    f = F0 + WIDTH * np.linspace(-6.0, 12.0, 61)
    record, sd = sweep(f, duffing(f, 5.0), 1e-4)
    (one,) = passes_of((record,))
    plain = ToneRecord("frf", "frf", f, record.drive_v, record.sense_v)
    assert jump_rows(record, one, WIDTH, sd).any()
    assert not jump_rows(plain, one, WIDTH, sd).any()
