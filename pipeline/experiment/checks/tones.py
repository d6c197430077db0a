"""Test sweeps and frequency responses before any fit.

| kind | found from |
|---|---|
| polarity | the sense in which the response turns: with rising frequency, the circle of a resonance turns clockwise |
| lag | the difference between sweeps up and down of one level: a detector that has not settled |
| silence | whether anything measures the noise |
| short | rows within a resonance |
| stuck | equal rows in succession |

Shapes: N rows, S senses.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ComplexArray, FloatArray
from ...errors import GyroscreenError
from ..noise.tones import tone_noise
from ..tones import SweepPass, ToneCampaign, ToneRecord, passes_of
from .check import CheckReport, worst_first
from .finding import Finding
from .levels import Level

#: Fewest rows above half of the highest power that show the shape of a resonance, and longest run of equal rows by chance.
_FEWEST_ROWS, _STUCK = 4, 3
#: Share of the response, and multiple of the noise, above which sweeps up and down differ.
_DIFFERS, _SD = 0.02, 6.0


def check_tones(campaign: ToneCampaign) -> CheckReport:
    """All tests in the table above; nothing is fitted and nothing is changed."""
    passes = passes_of(campaign.records)
    findings: list[Finding] = []
    levels = []
    try:
        noise = tone_noise(campaign.records)
        floors: list[FloatArray | None] = [np.sqrt(np.mean(sd**2, axis=0)) for sd in noise.sd_v]
        if not noise.known:
            text = (
                "Nothing measures the noise: neighbouring rows differ by more than a smooth response explains. Repeat a sweep,"
                " take finer steps, or declare sense1_sd_V under [columns]; without, only relative errors are given."
            )
            findings.append(Finding("silence", "note", text))
    except GyroscreenError as error:
        floors = [None] * len(campaign.records)
        findings.append(Finding("silence", "warning", f"{error.what}. {error.next_step or ''}".strip()))
    for record, floor in zip(campaign.records, floors):
        own = [one for one in passes if campaign.records[one.record] is record]
        for k, y in enumerate(record.sense_v.T):
            size = np.abs(y)
            channel = f"sense{k + 1}"
            sigma = None if floor is None else float(floor[k])
            # A level without a measured floor shows none.
            shown = 0.0 if sigma is None else sigma
            levels.append(
                Level(record.name, channel, 0.0, float(np.sqrt(np.mean(size**2))), float(size.max()), shown, None)
            )
            findings += _polarity(record, own, k)
            findings += _short(record, own, k)
            findings += _stuck(record, y, channel)
            findings += [] if sigma is None else _lag(record, own, k, sigma)
    return CheckReport(worst_first(findings), tuple(levels))


def _rising(record: ToneRecord, one: SweepPass, channel: int) -> tuple[FloatArray, ComplexArray]:
    """Frequencies and response per volt of drive of a pass, in the order of rising frequency."""
    f, y = record.frequency_hz[one.rows], record.sense_v[one.rows, channel] / record.level_v[one.rows]
    order = np.argsort(f, kind="stable")
    return f[order], y[order]


def _polarity(record: ToneRecord, passes: Sequence[SweepPass], channel: int) -> list[Finding]:
    """The signed area that the response encloses, relative to that of the circle of its size."""
    turned = []
    for one in passes:
        _, y = _rising(record, one, channel)
        area = 0.5 * float(np.sum((y[:-1].conj() * y[1:]).imag))
        turned.append(area / (np.pi * 0.25 * float(np.abs(y).max(initial=1e-300)) ** 2))
    if not turned or float(np.median(turned)) < 0.25:
        return []
    name = f"sense{channel + 1}"
    key = f"{name}_Y_V" if record.kind == "sweep" else f"H_s{channel + 1}d1_im"
    text = (
        f"The response turns counterclockwise as the frequency rises (signed area {np.median(turned):+.2f} of its circle); that"
        " of a passive resonator turns clockwise. Either the quadrature is inverted or it is the complex conjugate:"
        f" write a gain of -1 for {key} under [columns]."
    )
    return [Finding("polarity", "fault", text, record.name, name, float(np.median(turned)), None, "1")]


def _short(record: ToneRecord, passes: Sequence[SweepPass], channel: int) -> list[Finding]:
    counts = []
    for one in passes:
        power = np.abs(_rising(record, one, channel)[1]) ** 2
        counts.append(int(np.count_nonzero(power > 0.5 * power.max(initial=0.0))))
    if not counts or min(counts) >= _FEWEST_ROWS:
        return []
    text = (
        f"Only {min(counts)} rows lie above half of the highest power: the width of the resonance is hardly resolved. Take finer"
        " steps around it."
    )
    return [Finding("short", "warning", text, record.name, f"sense{channel + 1}", float(min(counts)), None, "1")]


def _stuck(record: ToneRecord, y: ComplexArray, channel: str) -> list[Finding]:
    equal = np.concatenate([[0], (np.diff(y) == 0.0).astype(np.int64), [0]])
    edges = np.flatnonzero(np.diff(equal))
    longest = int((edges[1::2] - edges[::2]).max(initial=0)) + 1
    if longest < _STUCK:
        return []
    text = f"{longest} rows in succession are equal: the detector overloaded, or the logger repeated a reading."
    return [Finding("stuck", "warning", text, record.name, channel, float(longest), None, "1")]


def _lag(record: ToneRecord, passes: Sequence[SweepPass], channel: int, sigma_v: float) -> list[Finding]:
    """Sweeps up and down of one level, compared where both measured."""
    for up in (one for one in passes if one.direction == "up" and record.kind == "sweep"):
        for down in (one for one in passes if one.direction == "down" and one.level == up.level):
            (f, y), (g, z) = _rising(record, up, channel), _rising(record, down, channel)
            inside = (f >= g[0]) & (f <= g[-1])
            if np.count_nonzero(inside) < _FEWEST_ROWS or f.size < 2:
                continue
            other = np.interp(f[inside], g, z.real) + 1.0j * np.interp(f[inside], g, z.imag)
            left = np.abs(y[inside] - other)
            largest = float(left.max() / np.abs(y).max())
            if largest > _DIFFERS and float(left.max() * record.level_v[up.first]) > _SD * sigma_v:
                text = (
                    f"Sweeps up and down differ by up to {100 * largest:.2g} % of the peak: the detector had not settled, or the"
                    " device is nonlinear. Wait longer at each frequency, or let refine decide."
                )
                return [Finding("lag", "note", text, record.name, f"sense{channel + 1}", largest, None, "1")]
    return []
