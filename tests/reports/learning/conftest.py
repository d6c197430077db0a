"""Answers and records of a synthetic device with cubic stiffness."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipeline.learning.answers import (
    CandidateAnswer,
    ComparisonAnswer,
    DiagnosisAnswer,
    Noise,
    Place,
    RefinementAnswer,
    RungAnswer,
)
from reports.learning.record_view import RecordView

RATE, N, SIGMA = 4000.0, 6000, 1e-3
T = np.arange(N) / RATE

_COMPARISON: dict[str, Any] = {
    "error": {"fit": 14.0, "validate": 12.3},
    "relative_error": {"fit": 0.02, "validate": 0.018},
    "where": (
        Place("resonance", "chirp", "sense1", (380.0, 420.0), 0.7, 30.0, family="frequency"),
        Place("harmonic", None, None, None, 0.2, 3.0, family="frequency", harmonic=3),
    ),
    "parameters": {"f1_hz": (399.0, 0.01), "f2_hz": (401.0, 0.01), "theta_deg": (89.9, 0.1), "split_hz": (2.0, 0.01)},
    "fit_ok": True,
    "noise": Noise((SIGMA, SIGMA), "silent"),
}
_CANDIDATE: dict[str, Any] = {
    "effect": "cubic_stiffness",
    "delta_chi2": 5e5,
    "p_value": 1e-200,
    "estimate": {"cubic_stiffness.k3": (1.2e9, 2e6)},
    "error_after": 1.0,
    "class_": 0,
    "detectable": True,
    "surviving_share": 0.9,
    "snr_at_reach": 40.0,
}
_DIAGNOSIS: dict[str, Any] = {
    "verdict": "effect",
    "effects": ("cubic_stiffness",),
    "candidates": (),
    "classes": (),
    "invisible": ("updown_tilt",),
    "error": {"fit": 14.0, "validate": 12.3},
    "p_left": 0.5,
    "left": "",
    "wrong_form": {},
    "why": "",
}
_RUNG: dict[str, Any] = {
    "effect": None,
    "status": None,
    "error_fit": 14.0,
    "error_validate": 12.3,
    "misfit_fit": 13.96,
    "misfit_validate": 12.26,
    "relative_error": 0.02,
    "delta_chi2": 0.0,
    "explained": 0.0,
    "held_out_fall": None,
    "held_out_sd": None,
    "terms": (),
    "dropped": (),
    "parameters": {"f1_hz": (399.0, 0.01)},
    "derived": {"theta_deg": (89.9, 0.1), "split_hz": (2.0, 0.01)},
    "verdict": "fail",
}
_CUBIC: dict[str, Any] = {
    **_RUNG,
    "effect": "cubic_stiffness",
    "status": "confirmed",
    "error_fit": 1.001,
    "error_validate": 1.0,
    "misfit_fit": 0.045,
    "misfit_validate": 0.0,
    "delta_chi2": 4.9e5,
    "explained": 0.9963,
    "held_out_fall": 2000.0,
    "held_out_sd": 90.0,
    "terms": ("cubic_stiffness",),
    "parameters": {"f1_hz": (400.0, 0.01), "cubic_stiffness.k3": (1.21e9, 2e6)},
    "derived": {"theta_deg": (-89.9, 0.1), "split_hz": (2.1, 0.01)},
    "verdict": "pass",
}
_REFINEMENT: dict[str, Any] = {
    "ladder": (RungAnswer(**_RUNG), RungAnswer(**_CUBIC)),
    "verdict": "adequate",
    "effects": ("cubic_stiffness",),
    "classes": (),
    "wrong_form": {},
    "refused": {},
    "regions": (),
    "p_left": 0.5,
    "left": "",
    "why": "",
}


@pytest.fixture(scope="session")
def comparison() -> Callable[..., ComparisonAnswer]:
    """Comparison of the first model; keywords replace fields."""
    return lambda **changes: ComparisonAnswer(**_COMPARISON | changes)


@pytest.fixture(scope="session")
def candidate() -> Callable[..., CandidateAnswer]:
    """Cubic stiffness as a candidate; keywords replace fields."""
    return lambda **changes: CandidateAnswer(**_CANDIDATE | changes)


@pytest.fixture(scope="session")
def diagnosis(candidate: Callable[..., CandidateAnswer]) -> Callable[..., DiagnosisAnswer]:
    """Diagnosis of cubic stiffness; keywords replace fields."""
    weak = candidate(effect="angular_rate", delta_chi2=0.5, p_value=1.0, estimate={}, class_=None, detectable=False)
    return lambda **changes: DiagnosisAnswer(**_DIAGNOSIS | {"candidates": (weak, candidate())} | changes)


@pytest.fixture(scope="session")
def rung() -> Callable[..., RungAnswer]:
    """The model with cubic stiffness; keywords replace fields."""
    return lambda **changes: RungAnswer(**_CUBIC | changes)


@pytest.fixture(scope="session")
def refinement() -> Callable[..., RefinementAnswer]:
    """Ladder of the first model and cubic stiffness; keywords replace fields, ``last`` those of the last rung."""

    def build(last: dict[str, Any] | None = None, **changes: Any) -> RefinementAnswer:
        ladder = (RungAnswer(**_RUNG), RungAnswer(**_CUBIC | (last or {})))
        return RefinementAnswer(**_REFINEMENT | {"ladder": ladder} | changes)

    return build


@pytest.fixture(scope="session")
def record() -> Callable[..., RecordView]:
    """Two crossing sweeps through a resonance; with ``cubic`` the model lacks the third harmonic of the response."""

    def build(name: str = "chirp", role: str = "fit", amplitude: float = 2.0, cubic: float = 4e-3) -> RecordView:
        sweep = 2 * np.pi * (300.0 * T + 0.5 * (500.0 - 300.0) / T[-1] * T**2)
        back = 2 * np.pi * (500.0 * T - 0.5 * (500.0 - 300.0) / T[-1] * T**2)
        drive = amplitude * np.stack([np.sin(sweep), np.sin(back)], axis=1)
        passage = np.exp(-(((T - 0.5 * T[-1]) / 0.12) ** 2))[:, None]
        model = amplitude * passage * np.stack([np.sin(sweep), np.cos(sweep)], axis=1)
        noise = SIGMA * np.random.default_rng(1 if role == "fit" else 2).standard_normal((N, 2))
        measured = model + cubic * model**3 + 0.02 + noise
        volts = measured - model
        residual = (volts - volts.mean(axis=0)) / SIGMA
        return RecordView(name, role, RATE, drive, measured, model, residual, float(np.sqrt(np.mean(residual**2))))

    return build
