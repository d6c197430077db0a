"""Study of the test duration: sequential test against a fixed one.

Virtual devices of the default population are chirped as in a run, with an interim analysis every tenth of a second:

    sequential         the rule of ``reports.sequential``, which bounds the error of every device beyond 2 final sd of a limit
    P(conform) alone   stops at the first analysis with P(conform) >= pass_at or <= fail_at: a bound on average only
    fixed T            decides once, after T seconds, by P(conform)

    wrong pass   passed although the truth does not conform (consumer's risk);   wrong fail likewise (producer's risk)

Few devices of the population are near a limit.  ``near_limits`` therefore puts limits near the first devices.
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
from ..process import worker_count
from ..screening.cluster import cluster
from ..screening.dispatch import in_parallel
from ..screening.settings import mismatch_prior, population, rate_of
from ..screening.virtual_device import physical_of, shared_record, virtual_records
from ..streaming.stream import verdicts_of
from .coverage import Share
from .near_limits import ALONE, SEQUENTIAL, NearVerdicts, near_figures, near_verdicts

#: Times of the interim analyses [s]; the last is the end of the record.
ANALYSIS_TIMES_S: tuple[float, ...] = tuple(round(0.1 * k, 1) for k in range(3, 31))
FIXED: tuple[float, ...] = (2.0, 3.0)
_SEQUENTIAL = (SEQUENTIAL, ALONE)
_BLOCK = 10
_STREAM_ANALYSIS = 107


@dataclass(frozen=True)
class Decided:
    """A verdict and the time [s] at which it was given; undecided at the end of the record."""

    verdict: Verdict
    time_s: float


@dataclass(frozen=True)
class InterimResults:
    """One device: whether it conforms, what each rule decided and when, and verdicts against limits near its truth."""

    conforms: bool
    decided: dict[str, Decided]
    near: tuple[NearVerdicts, ...] = ()


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
    return snapshot(
        data, sigma_v, previous, starts, rate_of(config, gain), config.judging_gate(), seed, mismatch_prior(config)
    )


def examine_device(
    config: RunConfig, drawn: Draw, i: int, angular_gain: float, limits: Limits, near: bool
) -> InterimResults:
    """What each rule decides about device i of a draw; with ``near``, about limits near its true values too."""
    instrument = config.instrument.instrument()
    silent, fit_v, _ = virtual_records(config, drawn, i)
    sigma_v = silent_sigma(silent, instrument.sample_rate_hz, config.line_hz(), instrument.adc)
    drive = shared_record(config).record.drive_v
    b = config.identification
    filtered = bandpass(np.concatenate([fit_v, drive], axis=1), instrument.sample_rate_hz, b.low_hz, b.high_hz)
    seeds = np.random.SeedSequence(config.run.seed, spawn_key=(_STREAM_ANALYSIS, int(drawn.index[i])))
    end_s = ANALYSIS_TIMES_S[-1]
    decided: dict[str, Decided] = {}
    analyses: list[dict[str, FloatArray] | None] = []
    previous: FloatArray | None = None
    for k, (time_s, seed) in enumerate(zip(ANALYSIS_TIMES_S, seeds.spawn(len(ANALYSIS_TIMES_S))), start=1):
        if len(decided) >= len(_SEQUENTIAL) and time_s not in FIXED and not near:
            continue
        samples = round(time_s * instrument.sample_rate_hz)
        found = _analyse(config, fit_v, filtered, sigma_v, samples, angular_gain, previous, seed)
        previous = found.x
        by_posterior, verdict = verdicts_of(found, limits, k, time_s == end_s)
        for rule, now in ((SEQUENTIAL, verdict), (ALONE, by_posterior)):
            if rule not in decided and (now != "undecided" or time_s == end_s):
                decided[rule] = Decided(now, time_s)
        if time_s in FIXED:
            decided[f"fixed {time_s:g} s"] = Decided(by_posterior, time_s)
        analyses.append(found.estimate.draws if found.estimate.status == "ok" else None)
    physical = physical_of(drawn.true)[i]
    truth = quantities(physical, rate_of(config, angular_gain), np.asarray(drawn.true["split_hz"][i]))
    against = near_verdicts(limits, truth, analyses, ANALYSIS_TIMES_S) if near else ()
    return InterimResults(bool(conforms(limits, truth)), decided, against)


def study_block(config: RunConfig, span: tuple[int, int, int]) -> list[InterimResults]:
    """The devices first .. first + count - 1, where span = (first, count, near); limits are put near devices below ``near``."""
    first, count, near = span
    with threadpool_limits(limits=1):
        spec = population(config)
        drawn = draw(spec, config.run.seed, first, count)
        gain, limits = float(spec.angular_gain), config.judged_by()
        return [examine_device(config, drawn, i, gain, limits, first + i < near) for i in range(count)]


def run_sequential_study(devices: int, near: int, seed: int, workers: int) -> list[InterimResults]:
    """What the rules decide about all devices, and about limits near the first ``near``; in the order of finished blocks.

    Raises
    ------
    UsageError : no devices.
    """
    if devices < 1:
        raise UsageError("no devices to study", value=devices, allowed="1 or more")
    config = load_config(None, {"seed": seed, "devices": devices})
    spans = [(first, min(_BLOCK, devices - first), near) for first in range(0, devices, _BLOCK)]
    found: list[InterimResults] = []
    with cluster(min(worker_count(workers), len(spans)), None) as client:
        for rows in in_parallel(client, study_block, config, spans):
            found += rows
    return found


def figures(rows: Sequence[InterimResults]) -> dict[str, Any]:
    """The figures of the study by name: duration and errors of each rule, then errors near a limit."""
    n = len(rows)
    out: dict[str, Any] = {"devices": n, "conforming": Share(sum(r.conforms for r in rows), n)}
    for rule in (*_SEQUENTIAL, *(f"fixed {time_s:g} s" for time_s in FIXED)):
        found = [(row.decided[rule], row.conforms) for row in rows]
        times = [one.time_s for one, _ in found]
        out[f"{rule}: mean duration, s"] = float(np.mean(times))
        out[f"{rule}: median duration, s"] = float(np.median(times))
        out[f"{rule}: wrong pass"] = Share(sum(one.verdict == "pass" and not good for one, good in found), n)
        out[f"{rule}: wrong fail"] = Share(sum(one.verdict == "fail" and good for one, good in found), n)
        out[f"{rule}: undecided"] = Share(sum(one.verdict == "undecided" for one, _ in found), n)
    near = [row.near for row in rows if row.near]
    return out | near_figures(near) if near else out
