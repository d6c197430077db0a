"""Streaming identification of a growing record, with a sequential decision.

pass / fail at the first estimate whose posterior probability of conformity crosses the rule's thresholds
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.errors import ConfigError
from pipeline.experiment.bad_samples import without_bad_samples
from pipeline.experiment.files.channels import correct
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Campaign, Channels, Record
from pipeline.identification.route import RouteResult
from pipeline.inference.estimate import RateSettings
from pipeline.inference.gate import Gate
from pipeline.inference.screening.campaign import campaign_noise
from pipeline.inference.screening.snapshot import Snapshot
from pipeline.inference.screening.stream import StreamSettings, start_stream, steps
from pipeline.inference.screening.stream_estimate import estimate, noise_of
from pipeline.inference.systematic import rate_settings
from reports.decision import Verdict, decide
from reports.limits import Limits

_SEED = 1
#: Share of an interval below which the remaining samples at the end give no estimate of their own.
_REST = 0.1


@dataclass(frozen=True, eq=False)
class Bench:
    """Prior knowledge of the bench; ``instrument`` ``None``: the default at the sample rate of the time stamps."""

    settings: StreamSettings
    instrument: Instrument | None
    channels: Channels
    rate: RateSettings
    gate: Gate


@dataclass(frozen=True, eq=False)
class StreamStep:
    """One estimate from the data so far, P(conform) and its verdict, and theta and split of the lattice."""

    snapshot: Snapshot
    p_pass: float
    verdict: Verdict
    route: RouteResult | None


def bench_of(campaign: Campaign | None, settings: StreamSettings) -> Bench:
    """Instrument, noise, wiring and demodulation from ``settings``, else from ``campaign``.

    Raises
    ------
    ConfigError : a lag between the channels, which a stream cannot correct.
    """
    if campaign is None:
        return Bench(settings, None, Channels(), RateSettings(), Gate())
    if campaign.channels.lag_samples:
        raise ConfigError(
            "a stream cannot correct a lag between channels",
            value=campaign.channels.lag_samples,
            allowed="lag_samples = 0",
            next_step="identify the whole record instead, without --stream",
        )
    if settings.sigma_v is None and campaign.with_role("noise"):
        noise, line_hz = campaign_noise(without_bad_samples(campaign))
        settings = replace(settings, sigma_v=tuple(noise.sigma_v.tolist()), line_hz=settings.line_hz or line_hz)
    return Bench(settings, campaign.instrument, campaign.channels, rate_settings(campaign), Gate())


def verdict_of(snapshot: Snapshot, limits: Limits) -> tuple[float, Verdict]:
    """P(conform) = share of the draws that meet all limits, nan if unknown, and the verdict of the rule."""
    estimate = snapshot.estimate
    draws = {name: estimate.draws.get(name, np.full(1, np.nan))[None] for name in limits.quantities}
    decision = decide(limits, draws, [estimate.status])
    return float(decision.p_pass[0]), decision.verdict[0]


def follow(blocks: Iterable[Record], bench: Bench, limits: Limits) -> Iterator[StreamStep]:
    """Estimates of a growing record at regular intervals, and one at its end.

    Raises
    ------
    MeasurementError : the noise is unknown when the first estimate is due, or a block does not fit.
    """
    stream = None
    noise = None
    previous: FloatArray | None = None
    done = 0
    for block in blocks:
        corrected = correct(block, bench.channels)
        if stream is None:
            instrument = bench.instrument or Instrument(sample_rate_hz=block.sample_rate_hz)
            stream = start_stream(instrument, bench.settings)
        for state, due in steps(stream, corrected.drive_v, corrected.sense_v):
            stream = state
            if due:
                done = stream.driven
                noise = noise or noise_of(stream)
                found, route = estimate(stream, noise, previous, bench.rate, bench.gate, np.random.SeedSequence(_SEED))
                previous = found.x
                yield StreamStep(found, *verdict_of(found, limits), route)
    if stream is not None and stream.driven - done > _REST * (stream.due - done):
        noise = noise or noise_of(stream)
        found, route = estimate(stream, noise, previous, bench.rate, bench.gate, np.random.SeedSequence(_SEED))
        yield StreamStep(found, *verdict_of(found, limits), route)
