"""Tests of amplitudes of free decays before any fit.

| kind | found from |
|---|---|
| decay | whether the amplitude falls, and by how much; a plateau at the start, at which something still drives |
| silence | whether the floor of the noise is reached, and whether anything measures the noise |
| lag | a filter that is too slow for the decay: |R| T of its time constant |
| stuck | equal rows in succession |

Shapes: N rows, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ...errors import GyroscreenError
from ..envelopes import EnvelopeRecord, settled_rows
from ..noise.envelopes import envelope_noise
from .check import CheckReport, worst_first
from .finding import Finding
from .levels import Level

#: Share of the first amplitude above which a start is a plateau, and its longest share of the record.
_FULL, _PLATEAU = 0.97, 0.05
#: Largest |R| T of a filter that follows the decay; longest run of equal rows by chance; least decay [factor].
_LAG, _STUCK, _LEAST = 0.1, 4, 1.5


def check_envelopes(records: Sequence[EnvelopeRecord]) -> CheckReport:
    """All tests in the table above; nothing is fitted and nothing is changed."""
    findings: list[Finding] = []
    levels = []
    for record in records:
        used = settled_rows(record)
        floors: FloatArray | None = None
        try:
            floors = envelope_noise(used).floor_v
        except GyroscreenError as error:
            findings.append(Finding("silence", "fault", f"{error.what}. {error.next_step or ''}".strip(), record.name))
        for k, a in enumerate(record.amplitude_v.T):
            floor = None if floors is None else float(floors[k])
            # A level without a measured floor shows none.
            shown = 0.0 if floor is None else floor
            rms = float(np.sqrt(np.mean(a**2)))
            levels.append(Level(record.name, f"sense{k + 1}", 0.0, rms, float(a.max()), shown, None))
            findings += _of_channel(record, a, f"sense{k + 1}", floor)
    return CheckReport(worst_first(findings), tuple(levels))


def _of_channel(record: EnvelopeRecord, a: FloatArray, channel: str, floor: float | None) -> list[Finding]:
    found = []

    def add(kind: str, severity: str, text: str, value: float) -> None:
        found.append(Finding(kind, severity, text, record.name, channel, value, None, "1"))  # type: ignore[arg-type]

    edge = max(a.size // 50, 3)
    fall = float(np.median(a[:edge]) / max(float(np.median(a[-edge:])), 1e-300))
    if fall < _LEAST:
        add("decay", "fault", f"The amplitude falls only by a factor of {fall:.3g}: this is no free decay.", fall)
        return found
    full = int(np.flatnonzero(a >= _FULL * a.max())[-1])
    if full > _PLATEAU * a.size:
        seconds = float(record.time_s[full] - record.time_s[0])
        text = (
            f"The amplitude stays near its largest value for the first {seconds:.4g} s: something still drives the device."
            f" Write start_s = {seconds:.6g} in this [[record]]."
        )
        add("decay", "warning", text, full / a.size)
    t, clear = record.time_s, np.minimum.accumulate(a > max(5.0 * (floor or 0.0), 0.3 * a.max()))
    count = max(int(np.count_nonzero(clear[full:])), 4)
    rate = -float(np.polyfit(t[full : full + count], np.log(np.maximum(a[full : full + count], 1e-300)), 1)[0])
    if rate * record.time_constant_s > _LAG:
        text = (
            f"The decay rate of {rate:.3g} 1/s is fast for the filter: it falls by {100 * rate * record.time_constant_s:.2g} %"
            " within a time constant. Record with a shorter time constant or a wider resolution bandwidth."
        )
        add("lag", "warning", text, rate * record.time_constant_s)
    equal = np.concatenate([[0], (np.diff(a) == 0.0).astype(np.int64), [0]])
    edges = np.flatnonzero(np.diff(equal))
    longest = int((edges[1::2] - edges[::2]).max(initial=0)) + 1
    if longest >= _STUCK:
        text = (
            f"{longest} rows in succession are equal: steps of the instrument are coarser than the decay between rows."
        )
        add("stuck", "warning", text, float(longest))
    if floor is not None and float(a[-edge:].min()) > 10.0 * floor:
        text = (
            "The decay is not recorded down to the noise, so that a constant background would look like a slower decay."
        )
        add("silence", "note", text, float(a[-edge:].min()) / max(floor, 1e-300))
    return found
