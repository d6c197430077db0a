"""Study of stepped sweeps: does the loop name the one effect that a simulated resonator has, and none where there is none?

    x'' + (w0/Q) x' + w0^2 x + k2 x^2 + k3 x^3 + d |x'| x' = g u     RK4, row after row

A lock-in average of x' over the last periods gives X + i Y, with a phase, an offset, feedthrough and settling.  No
code is shared with the model under test.  Two levels, up and down twice, the last two passes held out; white noise at 60 dB.

    DIR/<kind>.jsonl    one JSON object per campaign; an interrupted study continues there

A row depends on (seed, kind, number) only.  Shapes: N rows of a sweep.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from threadpoolctl import threadpool_limits

from pipeline.arrays import ComplexArray, FloatArray
from pipeline.device.model import Model
from pipeline.device.plant import PlantSpec
from pipeline.errors import GyroscreenError
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.tones import ToneCampaign, ToneRecord

from .coverage import Share
from .rows_by_kind import add_rows, is_right, is_wrong, outcome, processor_times

KINDS = (
    "none",
    "cubic_stiffness",
    "quadratic_stiffness",
    "nonlinear_damping",
    "parasitic_mode",
    "resistive_feedthrough",
    "lockin_settling",
)
#: Steps of a period; periods that are averaged; decay times before the average; rows of a pass; relative noise.
_STEPS, _AVERAGED, _DECAYS, _ROWS, _NOISE = 64, 4, 12.0, 30, 1e-3
_STREAM = 121


@njit(cache=True)
def _row(w: float, drive: float, p: FloatArray, state: FloatArray, periods: int) -> complex:
    """X + i Y of the velocity over the last periods, by RK4; ``p``: w0^2, w0/Q, k2, k3, d; ``state`` (x, x') is moved."""
    h = 2.0 * math.pi / w / _STEPS
    x, v, total = state[0], state[1], 0.0 + 0.0j
    for step in range(periods * _STEPS):
        kx, kv, ax, av, weight = 0.0, 0.0, 0.0, 0.0, 0.0
        for stage in range(4):
            share = 0.0 if stage == 0 else 0.5 if stage < 3 else 1.0
            px, pv = x + share * h * kx, v + share * h * kv
            kx = pv
            kv = drive * math.cos(2.0 * math.pi * (step + share) / _STEPS) - p[0] * px - p[1] * pv
            kv -= p[2] * px * px + p[3] * px * px * px + p[4] * abs(pv) * pv
            weight = 1.0 if stage in (0, 3) else 2.0
            ax += weight * kx
            av += weight * kv
        x += h / 6.0 * ax
        v += h / 6.0 * av
        if step >= (periods - _AVERAGED) * _STEPS:
            angle = 2.0 * math.pi * (step + 1) / _STEPS
            total += v * complex(math.cos(angle), -math.sin(angle))
    state[0], state[1] = x, v
    return total * 2.0 / (_AVERAGED * _STEPS)


def drawn_sweep(seed: int, kind: str, number: int) -> tuple[ToneCampaign, dict[str, float]]:
    """A campaign with the effect ``kind``, and its truth."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, KINDS.index(kind), number)))
    f0, q = float(10.0 ** random.uniform(2.0, 4.0)), float(10.0 ** random.uniform(1.6, 2.2))
    w0, gain, size = 2.0 * math.pi * f0, 40.0, float(random.uniform(0.15, 1.0))
    levels = (0.01, 0.02)
    amplitude = gain * levels[1] * q / w0**2
    k2 = k3 = drag = 0.0
    if kind == "cubic_stiffness":
        k3 = float(random.choice([-1.0, 1.0])) * 1.5 * size * (8.0 / 3.0) * w0**2 / (q * amplitude**2)
    if kind == "quadratic_stiffness":
        k2 = w0**2 / amplitude * math.sqrt(12.0 * 0.5 * size / (5.0 * q))
    if kind == "nonlinear_damping":
        drag = 0.6 * size * 3.0 * math.pi / (8.0 * q * amplitude)
    f = f0 * (1.0 + np.linspace(-4.0, 4.0, _ROWS) / q)
    passes = [(level, f if up else f[::-1]) for _ in range(2) for level in levels for up in (True, False)]
    frequency = np.concatenate([each for _, each in passes])
    drive = np.repeat([level for level, _ in passes], _ROWS)
    p, state = np.array([w0**2, w0 / q, k2, k3, drag]), np.zeros(2)
    periods = int(_DECAYS * q / math.pi) + _AVERAGED
    y = np.array([_row(2.0 * math.pi * a, gain * b, p, state, periods) for a, b in zip(frequency, drive)])
    peak = float(np.abs(y).max())
    y = _measured(y, kind, size, frequency, drive, f0, q, peak / levels[1], random)
    y = y + _NOISE * peak * (random.standard_normal(y.size) + 1.0j * random.standard_normal(y.size))
    held = 2 * _ROWS
    parts = (("sweep", "fit", slice(0, y.size - held)), ("last passes", "validate", slice(y.size - held, y.size)))
    times = np.asarray(np.arange(y.size) * 2.0, dtype=np.float64)
    records = tuple(
        ToneRecord(
            name, "sweep", frequency[rows], drive[rows, None] + 0.0j, y[rows, None], times[rows],
            role="fit" if role == "fit" else "validate",
        )
        for name, role, rows in parts
    )  # fmt: skip
    return ToneCampaign(f"{kind}-{number}", records, Instrument(1.0)), {"f0": f0, "q": q, "size": size}


def _measured(
    y: ComplexArray,
    kind: str,
    size: float,
    f: FloatArray,
    drive: FloatArray,
    f0: float,
    q: float,
    per_volt: float,
    random: np.random.Generator,
) -> ComplexArray:
    """What the lock-in shows: the linear effects, phase, offset and settling."""
    if kind == "parasitic_mode":
        own = f0 * (1.0 + float(random.choice([-1.0, 1.0])) * float(random.uniform(1.5, 3.0)) / q)
        width = float(random.uniform(0.3, 0.8)) * f0 / q
        y = y + 0.3 * size * per_volt * drive * (1j * f * width) / (own**2 - f**2 + 1j * f * width)
    if kind == "resistive_feedthrough":
        y = y + 0.2 * size * per_volt * drive
    y = y * np.exp(1j * float(random.uniform(-math.pi, math.pi)))
    y = y + 0.02 * float(np.abs(y).max()) * complex(*random.standard_normal(2))
    if kind == "lockin_settling":
        share = 0.3 * size
        for i in range(1, y.size):
            y[i] += share * (y[i - 1] - y[i])
    return np.asarray(y)


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of campaign ``item`` = (kind, number), computed on a worker."""
    from ..learning import refine

    kind, number = item
    campaign, truth = drawn_sweep(seed, kind, number)
    row: dict[str, Any] = {"kind": kind, "number": number, "seed": seed, "truth": truth, "failed": ""}
    started = time.process_time()
    with threadpool_limits(limits=1):
        try:
            answer = refine(campaign, Model(PlantSpec(kind="modal"))).answer
        except GyroscreenError as error:
            return row | {"outcome": "failed", "failed": str(error), "cpu_seconds": time.process_time() - started}
    classes = [list(members) for members in answer.classes]
    return row | {
        "verdict": answer.verdict,
        "effects": list(answer.effects),
        "classes": classes,
        "error": answer.ladder[-1].error_validate if answer.ladder else None,
        "outcome": outcome(_truth(kind), answer.verdict, answer.effects, classes),
        "cpu_seconds": time.process_time() - started,
    }


def _truth(kind: str) -> str | None:
    """The effect of a kind, if it has one."""
    return None if kind == "none" else kind


def run_study(kinds: Sequence[str], campaigns: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the files in ``folder``; yields (done, total).

    Raises
    ------
    UsageError : an unknown kind, or the folder cannot be written.
    """
    return add_rows(study_row, KINDS, kinds, campaigns, seed, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Share | str]:
    """Shares of campaigns with an effect that are right and wrong, of those without one, and the processor time."""
    found: dict[str, Share | str] = {}
    for label, own in (
        ("one effect", [row for row in rows if row["kind"] != "none"]),
        ("no effect", [row for row in rows if row["kind"] == "none"]),
    ):
        for what, holds in (("right", is_right), ("wrong", is_wrong)):
            found[f"{label}: {what}"] = Share(sum(holds(row, _truth(row["kind"])) for row in own), len(own))
    return found | processor_times(rows)
