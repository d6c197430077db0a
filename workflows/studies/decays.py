"""Study of free decays: does one ring-down name its effect?

    x'' + 2 zeta w x' + w^2 x + k3 x^3 + k2 x^2 + d |x'| x' = 0        by scipy's DOP853: no code of the model

Drawn are frequency, Q, sample rate, unit of the signal, duration, initial phase, SNR, offset and the size of the effect, which
is drawn again until it leaves at least ``_VISIBLE`` sigmas beside the best linear decay.  Two modes are two such equations
without an effect.  SNR is the rms of the motion at the start over the white noise.  The record is divided as that of
kind = "decay" in campaign.toml.

    DIR/<kind>.jsonl    one JSON object per decay; an interrupted study continues there

A row depends on (seed, kind, number) only.  Shapes: N samples.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.device.model import Model, PlantSpec
from pipeline.errors import GyroscreenError
from pipeline.experiment.decays.pieces import decay_pieces
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Record

from ..learning import refine
from .coverage import Share
from .rows_by_kind import LARGEST_CLASS, add_rows, is_right, is_wrong, outcome, processor_times

KINDS: dict[str, str] = {
    "none": "one linear mode",
    "cubic_stiffness": "one mode that stiffens or softens",
    "quadratic_stiffness": "one mode with asymmetric stiffness",
    "nonlinear_damping": "one mode with drag",
    "two_modes": "two linear modes",
}
#: Least misfit of the best linear decay that an effect must leave: norm of the difference over sigma.
_VISIBLE = 20.0
#: Longest record, so that a study of 500 decays takes an hour: cycles, and samples.
_MOST_CYCLES, _MOST_SAMPLES = 1200, 40_000
_FREQUENCY_HZ, _QUALITY, _SNR = (5.0, 20_000.0), (50.0, 2000.0), (20.0, 1000.0)
#: Relative change of frequency at the first amplitude; k2 A / w^2; added damping over zeta.
_CUBIC, _QUADRATIC, _DRAG = (1e-5, 3e-2), (3e-3, 0.15), (0.03, 2.0)
_STREAM = 121


@dataclass(frozen=True)
class DrawnDecay:
    """A decay: modes (frequency [Hz], Q, amplitude), effect sizes k3, k2, d in units of the signal, experiment, SNR, offset."""

    frequency_hz: tuple[float, ...]
    quality: tuple[float, ...]
    amplitude: tuple[float, ...]
    phase: tuple[float, ...]
    k3: float
    k2: float
    d: float
    rate_hz: float
    samples: int
    snr: float
    offset: float

    @property
    def sigma(self) -> float:
        """Noise per sample [unit of the signal]."""
        return math.hypot(*self.amplitude) / math.sqrt(2.0) / self.snr


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** random.uniform())


def draw_decay(kind: str, random: np.random.Generator) -> DrawnDecay:
    """A decay of this kind."""
    f, q = _log_uniform(random, *_FREQUENCY_HZ), _log_uniform(random, *_QUALITY)
    ring_downs = random.uniform(2.0, 8.0)
    cycles = min(ring_downs * q / math.pi, _MOST_CYCLES)
    rate = f * min(random.uniform(8.0, 40.0), _MOST_SAMPLES / cycles)
    a = _log_uniform(random, 1e-6, 10.0)
    w, sign = 2.0 * math.pi * f, float(random.choice([-1.0, 1.0]))
    k3, k2, d = 0.0, 0.0, 0.0
    if kind == "cubic_stiffness":
        shift = _log_uniform(random, *_CUBIC)
        k3 = sign * min(shift, 1e-2 if sign < 0.0 else shift) * 8.0 / 3.0 * (w / a) ** 2
    elif kind == "quadratic_stiffness":
        k2 = sign * _log_uniform(random, *_QUADRATIC) * w**2 / a
    elif kind == "nonlinear_damping":
        d = _log_uniform(random, *_DRAG) / (2.0 * q) * 0.75 * math.pi / a
    modes: tuple[tuple[float, float, float], ...] = ((f, q, a),)
    if kind == "two_modes":
        other = f * random.uniform(1.15, 2.4)
        modes = (*modes, (other, q * random.uniform(0.5, 2.0), a * random.uniform(0.2, 1.0)))
        rate = max(rate, 6.0 * other)
    return DrawnDecay(
        frequency_hz=tuple(mode[0] for mode in modes),
        quality=tuple(mode[1] for mode in modes),
        amplitude=tuple(mode[2] for mode in modes),
        phase=tuple(random.uniform(0.0, 2.0 * math.pi, len(modes)).tolist()),
        k3=k3,
        k2=k2,
        d=d,
        rate_hz=rate,
        samples=int(cycles / f * rate),
        snr=_log_uniform(random, *_SNR),
        offset=a * random.uniform(-1.0, 1.0),
    )


def motion(decay: DrawnDecay) -> FloatArray:
    """Noise-free samples (N,)."""
    t = np.arange(decay.samples) / decay.rate_hz
    total = np.full(t.size, decay.offset)
    for f, q, a, phase in zip(decay.frequency_hz, decay.quality, decay.amplitude, decay.phase):
        w = 2.0 * math.pi * f
        # Time in radians and motion in amplitudes: the numbers of the integrator are near 1.
        k3, k2, drag = decay.k3 * a**2 / w**2, decay.k2 * a / w**2, decay.d * a

        def slope(
            _: float, s: FloatArray, k3: float = k3, k2: float = k2, drag: float = drag, q: float = q
        ) -> list[float]:
            x, v = float(s[0]), float(s[1])
            return [v, -x * (1.0 + k2 * x + k3 * x * x) - v * (1.0 / q + drag * abs(v))]

        start = [math.cos(phase), -math.sin(phase)]
        total += a * solve_ivp(slope, (0.0, w * t[-1]), start, "DOP853", w * t, rtol=1e-9, atol=1e-11).y[0]
    return total


def visible(decay: DrawnDecay, clean: FloatArray) -> float:
    """Norm of the difference of noise-free samples (N,) from the best linear decay of one mode, over sigma."""
    t = np.arange(clean.size) / decay.rate_hz
    w0 = 2.0 * math.pi * decay.frequency_hz[0]

    def rest(p: FloatArray) -> FloatArray:
        e = np.exp((-p[1] + 1j * p[0]) * w0 * t)
        columns = np.stack([np.ones(t.size), e.real, e.imag], axis=1)
        return np.asarray(clean - columns @ np.linalg.lstsq(columns, clean, rcond=None)[0])

    starts = ([1.0 + shift, 0.5 / decay.quality[0]] for shift in (0.0, 3e-3, -3e-3))
    scale = [1.0 / (w0 * t[-1]), 0.1 / decay.quality[0]]
    found = min(
        (least_squares(rest, start, x_scale=scale, max_nfev=30) for start in starts), key=lambda one: float(one.cost)
    )
    return math.sqrt(2.0 * float(found.cost)) / decay.sigma


def drawn(seed: int, kind: str, number: int) -> tuple[DrawnDecay, FloatArray, float]:
    """The decay with this kind and number, its noisy samples (N,), and how visible its effect is [sigma]."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, list(KINDS).index(kind), number)))
    while True:
        decay = draw_decay(kind, random)
        clean = motion(decay)
        seen = visible(decay, clean) if kind not in ("none", "two_modes") else 0.0
        if kind in ("none", "two_modes") or seen >= _VISIBLE:
            return decay, clean + decay.sigma * random.standard_normal(clean.size), seen


def decay_campaign(decay: DrawnDecay, y: FloatArray) -> Campaign:
    """The pieces of a decay y (N,) as a campaign."""
    record = Record("decay", decay.rate_hz, np.zeros((y.size, 0)), y[:, None], at_rest=False)
    return Campaign("decay", decay_pieces(record, None), Instrument(decay.rate_hz))


def study_row(seed: int, item: tuple[str, int]) -> dict[str, Any]:
    """The row of decay ``item`` = (kind, number), computed on a worker."""
    kind, number = item
    decay, y, seen = drawn(seed, kind, number)
    row: dict[str, Any] = {
        "kind": kind,
        "number": number,
        "seed": seed,
        "decay": asdict(decay),
        "visible": seen,
        "failed": "",
    }
    started = time.process_time()
    with threadpool_limits(limits=1):
        try:
            model = Model(PlantSpec("modal", len(decay.frequency_hz), "displacement"))
            answer = refine(decay_campaign(decay, y), model).answer
        except GyroscreenError as error:
            return row | {"outcome": "failed", "failed": str(error), "cpu_seconds": time.process_time() - started}
    found = {"verdict": answer.verdict, "effects": answer.effects, "classes": answer.classes}
    names = [(rung.effect, rung.status) for rung in answer.ladder]
    row |= {
        "outcome": outcome(_truth(kind), answer.verdict, answer.effects, answer.classes),
        "ladder": names,
        "parameters": answer.parameters,
    }
    return row | found | {"cpu_seconds": time.process_time() - started}


def _truth(kind: str) -> str | None:
    """The effect of a kind, if it has one."""
    return kind if kind not in ("none", "two_modes") else None


def run_study(kinds: Sequence[str], decays: int, seed: int, folder: Path, workers: int) -> Iterator[tuple[int, int]]:
    """Add the missing rows to the files in ``folder``; yields (done, total).

    Raises
    ------
    UsageError : an unknown kind, or the folder cannot be written.
    """
    return add_rows(study_row, KINDS, kinds, decays, seed, folder, workers)


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Share | str]:
    """Shares of decays with each outcome, by kind and in all."""
    found: dict[str, Share | str] = {}
    groups = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS} | {"all": list(rows)}
    for kind, own in groups.items():
        if own:
            right, wrong = (sum(one(row, _truth(row["kind"])) for row in own) for one in (is_right, is_wrong))
            found[f"{kind}: correct, or a class of at most {LARGEST_CLASS}"] = Share(right, len(own))
            found[f"{kind}: wrong"] = Share(wrong, len(own))
    return found | processor_times(rows)
