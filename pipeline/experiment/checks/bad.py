"""Bad samples of each record: what was found, where, and what the fits do with it."""

from __future__ import annotations

from ..bad_samples import MOST_BAD, share_of_bad
from ..record import BadStretch, Record
from .finding import Finding

_NAMES = {"spike": "spike", "stuck": "stuck", "dropout": "at 0 V", "full_scale": "at the full scale of the ADC"}
#: Stretches that the text lists.
_LISTED = 6


def bad_samples(record: Record) -> list[Finding]:
    """A warning for a marked record with bad samples, a fault where they are too many."""
    found, share = record.bad, share_of_bad(record)
    if not found:
        return []
    count = sum(one.stop - one.first for one in found)
    listed = "; ".join(_shown(one, record.sample_rate_hz) for one in found[:_LISTED])
    more = f"; and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    text = f"{count} bad samples in {len(found)} stretches: {listed}{more}."
    if share > MOST_BAD:
        text += (
            f" They are {100.0 * share:.2g} % of a channel (limit {100.0 * MOST_BAD:g} %), so no fit uses the record. Measure"
            " again, or cut the record with start and stop in its [[record]]."
        )
        return [Finding("bad_samples", "fault", text, record.name, None, 100.0 * share, None, "%")]
    text += " Every fit leaves them out. Check cables, connectors and the logger."
    return [Finding("bad_samples", "warning", text, record.name, None, 100.0 * share, None, "%")]


def _shown(one: BadStretch, rate_hz: float) -> str:
    place = f"sense{one.channel + 1} {one.first / rate_hz:.5g} s"
    return f"{place} {_NAMES[one.reason]}" + (f", {one.stop - one.first} samples" if one.stop - one.first > 1 else "")
