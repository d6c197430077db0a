"""Study of the test duration: sequential test against a fixed one.

Virtual devices of the default population are chirped as in a run, with an interim analysis every tenth of a second:

    sequential   stops at the first interim analysis with P(conform) >= 1 - a (pass) or <= a (fail); else undecided
    fixed T      decides once, after T seconds, by the same rule

    wrong pass   passed although the truth does not conform (consumer's risk);   wrong fail likewise (producer's risk)

P(conform) is a posterior probability, so repeated analyses do not by themselves raise the average error rate above a.
``fit_arx`` on the same samples gives the model of the lattice and is faster for complete records.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.arrays import FloatArray
from pipeline.errors import UsageError
from pipeline.experiment.noise.lines import silent_sigma
from pipeline.experiment.record import Record
from pipeline.identification.arx import fit_arx
from pipeline.identification.bandpass import bandpass
from pipeline.identification.failure import IdentificationError
from pipeline.inference.estimate import quantities
from pipeline.inference.screening.compressed import BandData, nuisance_basis
from pipeline.inference.screening.inband import Band, make_band
from pipeline.inference.screening.snapshot import Snapshot, snapshot
from pipeline.inference.screening.stream import StreamSettings
from pipeline.inference.screening.stream_estimate import route_of, start_orders, starts_of
from populations.draw import Draw, draw
from reports.decision import Verdict, conforms
from reports.limits import Limits

from ..config import RunConfig, load_config
from ..machine import worker_count
from ..screening.cluster import cluster, in_parallel
from ..screening.settings import population, rate_of
from ..screening.virtual_device import physical_of, shared_record, virtual_records
from ..streaming.stream import verdict_of
from .coverage import Share

#: Times of the interim analyses [s]; the last is the end of the record.
ANALYSIS_TIMES_S: tuple[float, ...] = tuple(round(0.1 * k, 1) for k in range(3, 31))
FIXED: tuple[float, ...] = (2.0, 3.0)
#: A device is followed until P(conform) is this close to 0 or 1, so that stricter rules can use the same analyses.
_SURE = 0.001
_STRICTER: tuple[float, ...] = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_BLOCK = 10
_STREAM_ANALYSIS = 107


@dataclass(frozen=True)
class InterimResults:
    """One device: whether it conforms, P(conform) at ``ANALYSIS_TIMES_S``, and time [s] -> P(conform) of fixed tests.

    nan where P(conform) is unknown; the analyses stop where it is close to 0 or 1.
    """

    conforms: bool
    p_pass: tuple[float, ...]
    fixed: dict[float, float]


@lru_cache(maxsize=64)
def _band(config_key: bytes, samples: int) -> tuple[Band, FloatArray]:
    config = msgspec.msgpack.decode(config_key, type=RunConfig)
    i = config.identification
    drive = shared_record(config).record.drive_v[:samples]
    band = make_band(drive, config.instrument.instrument(), i.low_hz, i.high_hz)
    return band, nuisance_basis(band, config.line_hz())


def _analyse(
    config: RunConfig, fit_v: FloatArray, filtered: FloatArray, sigma_v: FloatArray, samples: int, gain: float,
    previous: FloatArray | None, seed: np.random.SeedSequence,
) -> Snapshot:  # fmt: skip
    instrument, i = config.instrument.instrument(), config.identification
    settings = StreamSettings(i.order, i.low_hz, i.high_hz)
    band, nuisance = _band(msgspec.msgpack.encode(config), samples)
    sense = fit_v[:samples]

    def starts() -> Sequence[FloatArray]:
        routes = []
        for order in start_orders(i.order):
            with suppress(IdentificationError, np.linalg.LinAlgError):
                model = fit_arx(filtered[:samples, :2], filtered[:samples, 2:], order, direct=instrument.hold != "zoh")
                routes.append(route_of(model, instrument, settings))
        record = Record("so far", instrument.sample_rate_hz, band.drive_v, sense)
        return starts_of(routes, record, instrument, settings, sigma_v)

    data = BandData(band, band.transform(sense), nuisance)
    return snapshot(data, sigma_v, previous, starts, rate_of(config, gain), config.gate.gate(), seed)


def examine_device(config: RunConfig, drawn: Draw, i: int, angular_gain: float, limits: Limits) -> InterimResults:
    """P(conform) of device i of a draw at all interim analyses until it is close to 0 or 1, and at the fixed times."""
    instrument = config.instrument.instrument()
    silent, fit_v, _ = virtual_records(config, drawn, i)
    sigma_v = silent_sigma(silent, instrument.sample_rate_hz, config.line_hz(), instrument.adc)
    drive = shared_record(config).record.drive_v
    b = config.identification
    filtered = bandpass(np.concatenate([fit_v, drive], axis=1), instrument.sample_rate_hz, b.low_hz, b.high_hz)
    seeds = np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM_ANALYSIS, int(drawn.index[i])))
    p_pass: list[float] = []
    fixed: dict[float, float] = {}
    previous: FloatArray | None = None
    for time_s, seed in zip(ANALYSIS_TIMES_S, seeds.spawn(len(ANALYSIS_TIMES_S))):
        sure = bool(p_pass) and min(p_pass[-1], 1.0 - p_pass[-1]) <= _SURE
        if sure and time_s not in FIXED:
            continue
        samples = round(time_s * instrument.sample_rate_hz)
        found = _analyse(config, fit_v, filtered, sigma_v, samples, angular_gain, previous, seed)
        previous = found.x
        p, _ = verdict_of(found, limits)
        if not sure:
            p_pass.append(p)
        if time_s in FIXED:
            fixed[time_s] = p
    physical = physical_of(drawn.true)[i]
    truth = quantities(physical, rate_of(config, angular_gain), np.asarray(drawn.true["split_hz"][i]))
    return InterimResults(bool(conforms(limits, truth)), tuple(p_pass), fixed)


def study_block(config: RunConfig, span: tuple[int, int]) -> list[InterimResults]:
    """The devices first .. first + count - 1, where span = (first, count)."""
    first, count = span
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, first, count)
        return [examine_device(config, drawn, i, float(spec.angular_gain), config.judged_by()) for i in range(count)]


def run_sequential_study(devices: int, seed: int, workers: int) -> list[InterimResults]:
    """The interim analyses of all devices, in the order in which their blocks finished.

    Raises
    ------
    UsageError : no devices.
    """
    if devices < 1:
        raise UsageError("no devices to study", value=devices, allowed="1 or more")
    config = load_config(None, {"seed": seed, "devices": devices})
    spans = [(first, min(_BLOCK, devices - first)) for first in range(0, devices, _BLOCK)]
    found: list[InterimResults] = []
    with cluster(min(worker_count(workers), len(spans)), None) as client:
        for rows in in_parallel(client, study_block, config, spans):
            found += rows
    return found


@dataclass(frozen=True)
class Test:
    """Result of a test: mean duration [s], and shares of all devices."""

    mean_s: float
    wrong_pass: Share
    wrong_fail: Share
    undecided: Share


def _verdict(p: float, a: float) -> Verdict:
    if p >= 1.0 - a:
        return "pass"
    return "fail" if p <= a else "undecided"


def _tested(rows: Sequence[InterimResults], verdicts: Sequence[Verdict], seconds: Sequence[float]) -> Test:
    n = len(rows)
    wrong_pass = sum(v == "pass" and not row.conforms for v, row in zip(verdicts, rows))
    wrong_fail = sum(v == "fail" and row.conforms for v, row in zip(verdicts, rows))
    undecided = sum(v == "undecided" for v in verdicts)
    return Test(float(np.mean(seconds)), Share(wrong_pass, n), Share(wrong_fail, n), Share(undecided, n))


def fixed_test(rows: Sequence[InterimResults], time_s: float, a: float) -> Test:
    """pass or fail by P(conform) >= 1 - a or <= a after ``time_s`` [s], one of ``FIXED``; undecided between."""
    return _tested(rows, [_verdict(row.fixed[time_s], a) for row in rows], [time_s] * len(rows))


def sequential_test(rows: Sequence[InterimResults], a: float) -> Test:
    """pass or fail at the first analysis with P(conform) >= 1 - a or <= a; undecided at the end of the record."""
    verdicts: list[Verdict] = []
    seconds = []
    for row in rows:
        decided = [(_verdict(p, a), t) for p, t in zip(row.p_pass, ANALYSIS_TIMES_S) if _verdict(p, a) != "undecided"]
        verdict, time_s = decided[0] if decided else ("undecided", ANALYSIS_TIMES_S[-1])
        verdicts.append(verdict)
        seconds.append(time_s)
    return _tested(rows, verdicts, seconds)


def as_good_as(rows: Sequence[InterimResults], fixed: Test) -> tuple[float, Test] | None:
    """The loosest threshold a at which the sequential test has no more wrong passes and wrong fails than ``fixed``.

    Returns a and that test; ``None`` if no threshold of ``_STRICTER`` is strict enough.
    """
    for a in _STRICTER:
        test = sequential_test(rows, a)
        if test.wrong_pass.count <= fixed.wrong_pass.count and test.wrong_fail.count <= fixed.wrong_fail.count:
            return a, test
    return None


def figures(rows: Sequence[InterimResults], a: float) -> dict[str, Any]:
    """The figures of the study by name, for the thresholds a and 1 - a."""
    two = fixed_test(rows, 2.0, a)
    out: dict[str, Any] = {"devices": len(rows), "conforming": Share(sum(r.conforms for r in rows), len(rows))}
    tests = {"sequential": sequential_test(rows, a), "fixed 2 s": two, "fixed 3 s": fixed_test(rows, 3.0, a)}
    if (same := as_good_as(rows, two)) is not None:
        tests[f"sequential at {same[0]:g}, no more errors than fixed 2 s"] = same[1]
    for name, test in tests.items():
        out[f"{name}: mean duration, s"] = test.mean_s
        out[f"{name}: wrong pass"] = test.wrong_pass
        out[f"{name}: wrong fail"] = test.wrong_fail
        out[f"{name}: undecided"] = test.undecided
    return out
