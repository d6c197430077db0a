"""Candidate experiments that may separate the members of a class, within what the device and the instrument have done before.

drive       at most the highest level of the existing records
response    predicted, below full scale of the converter (otherwise the level is reduced)
band        up to 0.9 of the anti-alias corner, and up to the highest frequency of the rows
clock       sample rate and hold of the campaign

Shapes of the excitation: chirps with the drives crossed, in phase, in antiphase and alone, also at a lower level; slow chirps
around the resonances, wide chirps, random-phase multisines, dwells on resonances.  Bias and rate are varied if an effect depends
on them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.excitation import Chirp, Excitation, Multisine, drive_samples
from ...experiment.instrument import Adc
from ...experiment.record import Campaign, Record
from ...inference.general.scales import top_hz
from ..campaign.rows import USABLE

#: Share of the level, and of the bias, at the experiment with less of it.
_LESS = 0.5
#: Unit of the edges of a band [Hz]: a wide one starts there, and it is the margin around the resonances.
_BIN_HZ = 10.0
#: Rates [deg/s], and the longest duration at first [s].
_RATES_DPS = (0.0, 100.0)
_LONGEST_S = 5.0


@dataclass(frozen=True)
class Experiment:
    """One record to be measured.

    Parameters
    ----------
    shape : of the excitation in words, without level and duration.
    excitation : of the drives.
    bias_v, rate_dps : declared conditions [V], [deg/s]; ``None``: the bias of the instrument, an unknown rate.
    """

    shape: str
    excitation: Excitation
    bias_v: float | None = None
    rate_dps: float | None = None

    @property
    def level_v(self) -> float:
        """Highest amplitude of any drive [V]."""
        return max((abs(a) for a in getattr(self.excitation, "amplitude_v", ())), default=0.0)

    @property
    def words(self) -> str:
        """Shape, level, duration, bias and rate."""
        parts = [self.shape, f"{self.level_v:.3g} V", f"{self.excitation.duration_s:g} s"]
        if self.bias_v is not None:
            parts.append(f"bias {self.bias_v:.3g} V")
        if self.rate_dps is not None:
            parts.append(f"rate {self.rate_dps:g} deg/s")
        return ", ".join(parts)

    def scaled(self, factor: float) -> Experiment:
        """Every amplitude times ``factor`` [1]; excitations other than chirp and multisine stay as they are."""
        full = self.excitation
        if not isinstance(full, Chirp | Multisine):
            return self
        return replace(self, excitation=replace(full, amplitude_v=tuple(factor * a for a in full.amplitude_v)))

    def lasting(self, duration_s: float) -> Experiment:
        """The same excitation stretched to ``duration_s`` [s]; the period of a multisine grows with it."""
        slow = self.excitation
        if isinstance(slow, Multisine):
            slow = replace(slow, period_s=slow.period_s * duration_s / slow.duration_s)
        return replace(self, excitation=replace(slow, duration_s=duration_s))

    def record(self, campaign: Campaign) -> Record:
        """The record before it is measured: drive (N, D) [V], sense (N, S) zero."""
        rate = campaign.instrument.sample_rate_hz
        drive = drive_samples(self.excitation, rate)
        sense = np.zeros((drive.shape[0], campaign.records[0].sense_v.shape[1]))
        return Record(self.shape, rate, drive, sense, role="fit", rate_dps=self.rate_dps, bias_v=self.bias_v)


def within(experiment: Experiment, peak_v: float, adc: Adc | None) -> Experiment:
    """``experiment``, with its level reduced if a response of ``peak_v`` [V] exceeds 0.9 of full scale."""
    if adc is None or peak_v <= USABLE * adc.full_scale_v:
        return experiment
    return experiment.scaled(0.98 * USABLE * adc.full_scale_v / peak_v)


def experiments(
    campaign: Campaign, model: Model, values: Mapping[str, float], terms: Sequence[str]
) -> tuple[Experiment, ...]:
    """The experiments that may be tried on the device of a campaign, the simplest first.

    Parameters
    ----------
    campaign : highest drive level [V], driven band [Hz] and typical duration [s] are those of its records.
    model, values : a fit, for its resonances [Hz].
    terms : members of the class; bias and rate are varied if one of them depends on it.
    """
    driven = [r for r in campaign.records if r.role in ("fit", "validate") and np.any(r.drive_v)]
    drives = driven[0].drive_v.shape[1]
    level = max(float(np.max(np.abs(r.drive_v))) for r in driven)
    duration = min(float(np.median([r.duration_s for r in driven])), _LONGEST_S)
    low, high = _band(driven)
    condition = _common(driven)
    shapes = _sweeps(low, high, level, duration, drives)
    plain = shapes[0]
    shapes.append(replace(plain.scaled(_LESS), shape=f"{plain.shape}, low level"))
    lines = sorted(v for name, v in values.items() if re.fullmatch(r"f\d+_hz", name))
    shapes += _wide(campaign, level, duration, drives)
    shapes += _resonant([f for f in lines if f < _top(campaign)], level, duration, drives)
    found = [replace(shape, bias_v=condition.bias_v, rate_dps=condition.rate_dps) for shape in shapes]
    if any(model.library[term].depends_on_bias for term in terms if term in model.library):
        bias = campaign.instrument.bias_v if condition.bias_v is None else condition.bias_v
        found.append(replace(found[0], bias_v=_LESS * bias))
    if any(model.library[term].condition == "rate" for term in terms if term in model.library):
        rates = [rate for rate in _RATES_DPS if rate == 0.0 or campaign.angular_gain is not None]
        found += [replace(found[0], rate_dps=rate) for rate in rates if rate != condition.rate_dps]
    return tuple(found)


def _common(driven: Sequence[Record]) -> Experiment:
    """Bias and rate that all records have in common."""
    biases, rates = {r.bias_v for r in driven}, {r.rate_dps for r in driven}
    return Experiment("", Chirp(), biases.pop() if len(biases) == 1 else None, rates.pop() if len(rates) == 1 else None)


def _top(campaign: Campaign) -> float:
    """Highest usable drive frequency [Hz]."""
    filter_ = campaign.instrument.antialias
    corner = campaign.instrument.sample_rate_hz / 2.0 if filter_ is None else filter_.corner_hz
    return min(USABLE * min(corner, campaign.instrument.sample_rate_hz / 2.0), top_hz(campaign.with_role("fit")))


def _band(driven: Sequence[Record]) -> tuple[float, float]:
    """Band [Hz] that contains all but 2 % of the energy of the drives, rounded outwards to 10 Hz."""
    low, high = np.inf, 0.0
    for record in driven:
        power: FloatArray = np.sum(np.abs(np.fft.rfft(record.drive_v, axis=0)) ** 2, axis=1)
        share = np.cumsum(power) / np.sum(power)
        edges = np.searchsorted(share, (0.01, 0.99)) * record.sample_rate_hz / record.drive_v.shape[0]
        low, high = min(low, float(edges[0])), max(high, float(edges[1]))
    return _BIN_HZ * max(np.floor(low / _BIN_HZ), 1.0), _BIN_HZ * np.ceil(high / _BIN_HZ)


def _sweeps(low: float, high: float, level: float, duration: float, drives: int) -> list[Experiment]:
    """Chirps: drives crossed, in phase (up and down), in antiphase, and one at a time."""

    def chirp(shape: str, ups: Sequence[bool], factors: Sequence[float]) -> Experiment:
        start, stop = tuple(low if up else high for up in ups), tuple(high if up else low for up in ups)
        return Experiment(shape, Chirp(start, stop, tuple(level * f for f in factors), duration))

    def one(up: bool, how: str, factors: Sequence[float]) -> Experiment:
        ends = f"{low:g} to {high:g} Hz" if up else f"{high:g} to {low:g} Hz"
        return chirp(f"chirp {ends}{how}", [up] * drives, factors)

    if drives == 1:
        return [one(True, "", (1.0,)), one(False, "", (1.0,))]
    cross = [k % 2 == 0 for k in range(drives)]
    signs = [1.0 if up else -1.0 for up in cross]
    odd, even = ("drive 1", "drive 2") if drives == 2 else ("odd drives", "even drives")
    band = f"crossed chirps {low:g} to {high:g} Hz"
    found = [
        chirp(f"{band}, {odd} up and {even} down", cross, [1.0] * drives),
        chirp(f"{band}, {odd} down and {even} up", [not up for up in cross], [1.0] * drives),
    ]
    found += [one(up, _in_phase(drives), [1.0] * drives) for up in (True, False)]
    found.append(one(True, ", drives opposite in sign", signs))
    alone = [[1.0 if k == d else 0.0 for d in range(drives)] for k in range(drives)]
    found += [one(True, f", drive {k + 1} alone", factors) for k, factors in enumerate(alone)]
    return found


def _in_phase(drives: int) -> str:
    return ", drives in phase" if drives > 1 else ""


def _wide(campaign: Campaign, level: float, duration: float, drives: int) -> list[Experiment]:
    top = _BIN_HZ * np.floor(_top(campaign) / _BIN_HZ)
    if top <= 2.0 * _BIN_HZ:
        return []
    band, all_ = f"{_BIN_HZ:g} to {top:g} Hz", (level,) * drives
    return [
        Experiment(
            f"wide chirp {band}{_in_phase(drives)}", Chirp((_BIN_HZ,) * drives, (top,) * drives, all_, duration)
        ),
        Experiment(f"random-phase multisine {band}", Multisine(_BIN_HZ, top, all_, duration, duration)),
    ]


def _resonant(lines: Sequence[float], level: float, duration: float, drives: int) -> list[Experiment]:
    """A slow chirp across all resonances, and dwells on single ones."""
    if not lines:
        return []
    low, high = max(round(lines[0] - _BIN_HZ), 1.0), float(round(lines[-1] + _BIN_HZ))
    all_ = (level,) * drives
    ends = ((low,) * drives, (high,) * drives)
    found = [Experiment(f"chirp {low:g} to {high:g} Hz{_in_phase(drives)}", Chirp(*ends, all_, duration))]
    for f in (round(line, 2) for line in lines[:3]):
        found.append(
            Experiment(f"dwell on {f:.2f} Hz{_in_phase(drives)}", Chirp((f,) * drives, (f,) * drives, all_, duration))
        )
    return found
