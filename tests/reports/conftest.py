"""A synthetic run: plausible devices with truth, posteriors and verdicts, without simulating a record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from pipeline.axial import wrap
from pipeline.quantities import IDENTIFIED, MODEL
from pipeline.store.schema import devices_table, posterior_table
from reports.decision import decide
from reports.limits import DEFAULT_LIMITS, Limits


@dataclass(frozen=True)
class SyntheticRun:
    """What reports need of a run."""

    devices: pa.Table
    posterior: pa.Table | None
    manifest: Mapping[str, Any]
    config_toml: str = 'devices = 200\n[limits.split_hz]\nmax = 3.0  # <&"\n'


MANIFEST = {
    "run_id": "synthetic",
    "status": "complete",
    "created": "2026-01-01T00:00:00+00:00",
    "finished": None,
    "config_sha256": "ab" * 32,
    "provenance": {"seed": 7, "git_revision": "0123abc", "versions": {"numpy": "2.4.6", "emcee": "3.1.6"}},
    "files": [
        {"name": "devices-00000.parquet", "kind": "devices", "sha256": "cd" * 32, "rows": 200},
        {"name": "report.html", "kind": "page", "sha256": "ef" * 32, "rows": None},
    ],
}

NAMES = tuple(quantity.name for quantity in IDENTIFIED)
SD = {
    "theta_deg": 0.05, "split_hz": 1e-3, "f1_hz": 1e-3, "f2_hz": 1e-3, "f3_hz": 1e-2, "zeta1": 2e-7, "zeta2": 2e-7,
    "zeta3": 2e-6, "c12_per_s": 2e-3, "rocking_gain": 1e-3, "updown_gain": 1e-3, "sense_imbalance": 2e-5,
    "drive_imbalance": 2e-5, "quality1": 60.0, "quality2": 60.0, "quality3": 0.8, "quadrature_rate_dps": 8.0,
    "quadrature_bias_dps": 0.14, "inphase_bias_dps": 0.5, "rate_bias_dps": 0.6,
}  # fmt: skip


def _truth(rng: np.random.Generator, e: np.ndarray, n: int) -> dict[str, np.ndarray]:
    """Quantities of devices with complex stiffness anisotropy e (n,)."""
    f0 = rng.normal(535.5, 5.0, n)
    split, theta = f0 * np.abs(e), wrap(0.5 * np.degrees(np.angle(e)))
    q = 2000.0 * np.exp(rng.normal(0.0, 0.25, (3, n)))
    q[2] *= 0.2
    quadrature = 360.0 / (2 * 0.7) * 2 * split * np.sin(2 * np.radians(theta))
    inphase = rng.normal(0.0, 7.0, n)
    return {
        "theta_deg": theta, "split_hz": split, "f1_hz": f0, "f2_hz": f0 + split, "f3_hz": 590.0 + rng.normal(0, 5.0, n),
        "zeta1": 0.5 / q[0], "zeta2": 0.5 / q[1], "zeta3": 0.5 / q[2], "c12_per_s": rng.normal(0, 0.2, n),
        "rocking_gain": rng.normal(40.0, 0.4, n), "updown_gain": rng.normal(40.0, 0.4, n),
        "sense_imbalance": rng.normal(0, 0.02, n), "drive_imbalance": rng.normal(0, 0.02, n),
        "quality1": q[0], "quality2": q[1], "quality3": q[2], "quadrature_rate_dps": quadrature,
        "quadrature_bias_dps": quadrature * np.radians(1.0), "inphase_bias_dps": inphase,
        "rate_bias_dps": quadrature * np.radians(1.0) + inphase,
    }  # fmt: skip


def _synthetic(
    n: int = 200,
    seed: int = 7,
    virtual: bool = True,
    limits: Limits = DEFAULT_LIMITS,
    wafers: int = 4,
    draws: int = 200,
) -> SyntheticRun:
    rng = np.random.default_rng(seed)
    wafer = np.arange(n) % wafers
    offset = rng.normal(0, 1e-3, (wafers, 2)) @ np.array([1.0, 1.0j])
    fab_e = offset[wafer] + rng.normal(0, 2.6e-3, (n, 2)) @ np.array([1.0, 1.0j])
    fab = _truth(np.random.default_rng(seed + 1), fab_e, n)
    true = _truth(np.random.default_rng(seed + 1), fab_e + rng.normal(0, 1.1e-3, (n, 2)) @ np.array([1.0, 1.0j]), n)
    true["quality1"] = true["quality1"] * np.where(rng.random(n) < 0.04, 0.1, 0.95)
    true["zeta1"] = 0.5 / true["quality1"]
    sd = {name: np.full(n, SD[name]) for name in NAMES}
    sample = {name: true[name][:, None] + rng.normal(0, 1, (n, 1)) * sd[name][:, None] for name in NAMES}
    sample = {name: sample[name] + sd[name][:, None] * rng.normal(size=(n, draws)) for name in NAMES}
    status = np.where(rng.random(n) < 0.03, "misfit", np.where(rng.random(n) < 0.02, "not_converged", "ok"))
    decisions = decide(limits, sample, list(status))
    columns: dict[str, Any] = {
        "device_id": [f"D{k:05d}" for k in range(n)],
        "status": list(status),
        "status_reason": [
            "error above the gate" if s == "misfit" else "R-hat above 1.01" if s != "ok" else None for s in status
        ],
        "p_pass": decisions.p_pass,
        "verdict": list(decisions.verdict),
        "failed_limits": list(decisions.failed_limits),
        "error": np.where(status == "misfit", 3.0 + rng.random(n), rng.normal(1.0, 0.004, n)),
        "rhat": 1.0 + 0.004 * rng.random(n),
        "ess": 1000.0 + 800.0 * rng.random(n),
        "acceptance": 0.4 + 0.2 * rng.random(n),
        "arx_split_hz": true["split_hz"] + rng.normal(0, 3e-3, n),
    }
    for name in ("theta_u1_deg", "theta_v1_deg", "theta_u2_deg", "theta_v2_deg"):
        columns[name] = wrap(true["theta_deg"] + rng.normal(0, 0.3, n) / np.maximum(true["split_hz"], 0.05))
    for name in NAMES:
        q05, mean, q95 = np.quantile(sample[name], [0.05, 0.5, 0.95], axis=1)
        columns |= {name: mean, f"{name}_sd": sd[name], f"{name}_q05": q05, f"{name}_q95": q95}
    for name in ("theta_deg", "theta_deg_q05", "theta_deg_q95"):
        columns[name] = wrap(columns[name])
    if virtual:
        side = int(np.ceil(np.sqrt(n / wafers)))
        place = np.arange(n) // wafers
        columns |= {"lot": [f"L{w // 2 + 1}" for w in wafer], "wafer": [f"W{w % 2 + 1}" for w in wafer]}
        columns |= {
            "die_x_mm": 8.0 * (place % side - (side - 1) / 2),
            "die_y_mm": 8.0 * (place // side - (side - 1) / 2),
        }
        columns |= {f"true_{name}": true[name] for name in NAMES} | {f"fab_{name}": fab[name] for name in NAMES}
    posterior: dict[str, Any] = {
        "device_id": np.repeat(columns["device_id"], draws),
        "draw": np.tile(np.arange(draws), n),
    }
    posterior |= {q.name: wrap(sample[q.name].ravel()) if q.axis else sample[q.name].ravel() for q in MODEL}
    return SyntheticRun(devices_table(columns), posterior_table(posterior), MANIFEST)


@pytest.fixture(scope="session")
def synthetic_run() -> Callable[..., SyntheticRun]:
    """Builds a run: n devices, seed, virtual or measured, limits, wafers, draws."""
    return _synthetic
