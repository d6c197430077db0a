"""How the records of a campaign differ, as an answer with sentences."""

from __future__ import annotations

from collections.abc import Callable

from ...experiment.variation import Deviations
from ...inference.general.variation import RecordVariation
from ..answers import Deviation, RecordsDiffer


def records_differ_answer(found: RecordVariation) -> RecordsDiffer:
    """Spreads, deviations and sentences of a variation; a kind that the records do not need has no sentence."""
    spread = found.spread
    return RecordsDiffer(
        spread={
            "frequency": spread.frequency,
            "start_s": spread.start_s,
            "gain": spread.gain,
            "ramp_v": spread.ramp_v,
        },
        records={one.record: _deviation(one) for one in found.deviations},
        text=tuple(_sentences(found)),
    )


def _deviation(one: Deviations) -> Deviation:
    pairs = [(float(v), float(sd)) for v, sd in zip(one.value, one.sd)]
    senses = one.gain.size
    return Deviation(
        frequency=pairs[0],
        start_s=pairs[1],
        gain=tuple(pairs[2 : 2 + senses]),
        ramp_v=tuple(pairs[2 + senses :]),
    )


def _sentences(found: RecordVariation) -> list[str]:
    spread, each = found.spread, found.deviations
    out = []
    if spread.frequency:
        out.append(_moved(each, "All natural frequencies", lambda one: 1e6 * one.frequency, "ppm"))
    if spread.start_s:
        out.append(_moved(each, "The start time", lambda one: 1e6 * one.start_s, "us"))
    for s in range(each[0].gain.size):

        def gain_ppm(one: Deviations, channel: int = s) -> float:
            return 1e6 * float(one.gain[channel])

        if spread.gain:
            out.append(_moved(each, f"The gain of sense{s + 1}", gain_ppm, "ppm"))
        if spread.ramp_v:
            drift = max(each, key=lambda one: abs(float(one.ramp_v[s])))
            out.append(
                f"The offset of sense{s + 1} drifted by up to {2e3 * abs(float(drift.ramp_v[s])):.2g} mV within a record"
                f" ({drift.record})."
            )
    return out


def _moved(each: tuple[Deviations, ...], what: str, of: Callable[[Deviations], float], unit: str) -> str:
    """The largest difference between two records, in their order."""
    low, high = min(each, key=of), max(each, key=of)
    first, last = sorted((low, high), key=each.index)
    change = of(last) - of(first)
    verb = "rose" if change > 0 else "fell"
    return f"{what} {verb} by {abs(change):.2g} {unit} from {first.record} to {last.record}."
