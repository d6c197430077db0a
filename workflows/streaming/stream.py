"""Streaming identification of a growing record, with a sequential decision.

pass / fail at the first estimate that is beyond the boundaries of ``reports.sequential``
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
from pipeline.inference.screening.campaign import campaign_noise, campaign_spectrum
from pipeline.inference.screening.snapshot import Snapshot
from pipeline.inference.screening.stream import StreamSettings, start_stream, steps
from pipeline.inference.screening.stream_estimate import estimate, noise_of
from pipeline.inference.systematic import rate_settings
from reports.decision import Verdict, decide
from reports.limits import Limits
from reports.sequential import checked, decide_at, margin

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
    """One estimate from the data so far, P(conform), its verdicts, and theta and split of the lattice.

    ``verdict`` is that of the sequential rule while the record may grow, ``verdict_at_end`` if it ends here.
    """

    snapshot: Snapshot
    p_pass: float
    verdict: Verdict
    verdict_at_end: Verdict
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
        good = without_bad_samples(campaign)
        noise, line_hz = campaign_noise(good)
        spectrum = campaign_spectrum(good, noise)
        settings = replace(settings, noise=spectrum, line_hz=settings.line_hz or line_hz)
    return Bench(settings, campaign.instrument, campaign.channels, rate_settings(campaign), Gate())


def verdicts_of(snapshot: Snapshot, limits: Limits, analysis: int, last: bool) -> tuple[Verdict, Verdict]:
    """The verdict of P(conform) alone, and that of the sequential rule at ``analysis`` 1, 2, ..; see ``reports.sequential``."""
    draws = _draws(snapshot, limits)
    decision = decide(limits, {name: values[None] for name, values in draws.items()}, [snapshot.estimate.status])
    return decision.verdict[0], checked(limits, decision.verdict[0], margin(limits, draws), analysis, last)


def _draws(snapshot: Snapshot, limits: Limits) -> dict[str, FloatArray]:
    draws = snapshot.estimate.draws
    return {name: draws.get(name, np.full(1, np.nan)) for name in limits.quantities}


def _step(found: Snapshot, route: RouteResult | None, limits: Limits, analysis: int) -> StreamStep:
    draws, status = _draws(found, limits), found.estimate.status
    p_pass, verdict = decide_at(limits, draws, status, analysis)
    _, at_end = decide_at(limits, draws, status, analysis, last=True)
    return StreamStep(found, p_pass, verdict, at_end, route)


def follow(blocks: Iterable[Record], bench: Bench, limits: Limits) -> Iterator[StreamStep]:
    """Estimates of a growing record at regular intervals, and one at its end.

    Raises
    ------
    MeasurementError : the noise is unknown when the first estimate is due, or a block does not fit.
    """
    stream = None
    noise = None
    previous: FloatArray | None = None
    done = analyses = 0
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
                previous, analyses = found.x, analyses + 1
                yield _step(found, route, limits, analyses)
    if stream is not None and stream.driven - done > _REST * (stream.due - done):
        noise = noise or noise_of(stream)
        found, route = estimate(stream, noise, previous, bench.rate, bench.gate, np.random.SeedSequence(_SEED))
        yield _step(found, route, limits, analyses + 1)
