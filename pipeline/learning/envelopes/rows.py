"""Amplitudes of free decays as rows: stretches of each record in units of the noise.

Where the role of a record is not stated, every third stretch is held out.  A block is a stretch: its amplitudes, then its phases
and frequencies as far as they are clear.

Shapes: N rows, S senses; a block is (m, 1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ...arrays import BoolArray, FloatArray
from ...criticism.problem import Candidate, Region, ResidualBlock, Signatures, TermParameter
from ...experiment.envelopes import EnvelopeRecord
from ...experiment.noise.envelopes import EnvelopeNoise
from ...inference.envelopes.model import Predicted
from ..joint.part import RecordLeft

#: Stretches of a record, and rows that each has at least; powers of the generic shapes.
_STRETCHES, _ROWS, _SHAPES = 12, 4, 3


@dataclass(frozen=True)
class Stretch:
    """Rows ``first`` .. ``stop`` - 1 of a record, and whether they are held out."""

    record: int
    first: int
    stop: int
    held: bool

    @property
    def rows(self) -> slice:
        """Its rows."""
        return slice(self.first, self.stop)


@dataclass(frozen=True, eq=False)
class EnvelopeRows:
    """The rows of some records at their noise."""

    records: tuple[EnvelopeRecord, ...]
    noise: tuple[EnvelopeNoise, ...]

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """Fitted ones, then those held out."""
        found = []
        for k, record in enumerate(self.records):
            count = max(min(_STRETCHES, record.time_s.size // _ROWS), 1)
            edges = np.linspace(0, record.time_s.size, count + 1).astype(int).tolist()
            for i, (first, stop) in enumerate(pairwise(edges)):
                held = record.role == "validate" or (record.role is None and count > 2 and i % 3 == 1)
                found.append(Stretch(k, first, stop, held))
        return tuple(sorted(found, key=lambda one: one.held))

    @property
    def held(self) -> int:
        """Stretches held out."""
        return sum(one.held for one in self.stretches)

    @property
    def fitted(self) -> tuple[Stretch, ...]:
        """The fitted stretches."""
        return self.stretches[: len(self.stretches) - self.held]

    @cached_property
    def fitted_rows(self) -> tuple[BoolArray, ...]:
        """For each record (N,) the rows that determine its free state: the fitted ones, or all of a record that is held out."""
        found = []
        for k, record in enumerate(self.records):
            own: BoolArray = np.zeros(record.time_s.size, dtype=np.bool_)
            for one in self.stretches:
                if one.record == k and not one.held:
                    own[one.rows] = True
            found.append(own if own.any() else ~own)
        return tuple(found)

    @cached_property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The stretches; the free states count with the first of each record."""
        rows = self.whitened([(r.amplitude_v, r.phase_rad, r.frequency_hz) for r in self.records])
        seen: set[int] = set()
        found = []
        for one, own in zip(self.stretches, rows):
            record = self.records[one.record]
            free = 0 if one.record in seen else 1 if record.phase_rad is None else 1 + record.phase_rad.shape[1]
            seen.add(one.record)
            size = float(record.amplitude_v[one.rows].mean() / record.amplitude_v.max())
            labels = {"level": f"{size:.2g}", "direction": "none", "drives": "none"}
            found.append(ResidualBlock(self._name(one), own, labels, nuisances=free))
        return tuple(found)

    def _name(self, one: Stretch) -> str:
        own = sorted(other.first for other in self.stretches if other.record == one.record)
        name = self.records[one.record].name
        return name if len(own) == 1 else f"{name} {own.index(one.first) + 1}/{len(own)}"

    def whitened(
        self, each: Sequence[tuple[FloatArray, FloatArray | None, FloatArray | None]]
    ) -> tuple[FloatArray, ...]:
        """Amplitude, phase and frequency of every record as blocks (m, 1) in units of the noise."""
        found = []
        for one in self.stretches:
            noise, (amplitude, phase, frequency), rows = self.noise[one.record], each[one.record], one.rows
            parts = [(amplitude[rows] / noise.amplitude_v[rows]).reshape(-1)]
            for values, sd in ((phase, noise.phase_rad), (frequency, noise.frequency_hz)):
                if values is not None and sd is not None:
                    clear = np.isfinite(sd[rows])
                    parts.append((values[rows][clear] / sd[rows][clear]).reshape(-1))
            found.append(np.concatenate(parts)[:, None])
        return tuple(found)

    def of(self, predicted: Sequence[Predicted]) -> tuple[FloatArray, ...]:
        """What a model predicts, as blocks."""
        return self.whitened([(one.amplitude_v, one.phase_rad, one.frequency_hz) for one in predicted])

    def probes(self, predicted: Sequence[Predicted]) -> Signatures:
        """The amplitude times powers of time and of itself: a wrong rate, a drift, a rate that depends on amplitude."""
        shapes: list[list[FloatArray]] = []
        for order in range(1, _SHAPES + 1):
            times = [(r.time_s - r.time_s[0]) / max(float(np.ptp(r.time_s)), 1e-300) for r in self.records]
            shapes.append([p.amplitude_v * t[:, None] ** order for p, t in zip(predicted, times)])
            largest = [max(float(p.amplitude_v.max()), 1e-300) for p in predicted]
            shapes.append([p.amplitude_v * (p.amplitude_v / size) ** order for p, size in zip(predicted, largest)])
        columns = []
        for shape in shapes:
            rows = self.whitened(
                [
                    (
                        own,
                        None if r.phase_rad is None else own / np.maximum(p.amplitude_v, 1e-300),
                        None if r.frequency_hz is None else own[:, 0] / np.maximum(p.amplitude_v[:, 0], 1e-300),
                    )
                    for own, p, r in zip(shape, predicted, self.records)
                ]
            )
            columns.append(rows)
        parameters = tuple(TermParameter(f"decay {i}") for i in range(len(columns)))
        candidates = tuple(Candidate(p.name, (p,), (slice(i, i + 1),)) for i, p in enumerate(parameters))
        blocks = (np.stack([c[b].reshape(-1) for c in columns], axis=1) for b in range(len(self.fitted)))
        return Signatures(candidates, tuple(blocks))

    def regions(self, blocks: Sequence[ResidualBlock], per_row: float) -> list[Region]:
        """Each stretch."""
        found = []
        for one, block in zip(self.fitted, blocks):
            t = self.records[one.record].time_s
            span = [float(t[one.first]), float(t[min(one.stop, t.size - 1)])]
            labels = {"record": self.records[one.record].name, "channel": "sense1", "time_s": span}
            found.append(Region("time", labels, block.chi2, block.residual.size * per_row))
        return found

    def misfit_regions(self, blocks: Sequence[ResidualBlock], per_row: float) -> list[Region]:
        """By time, level and record."""
        found = self.regions(blocks, per_row)
        for one, block in zip(self.fitted, blocks):
            labels: Mapping[str, object] = {
                "level": float(block.labels["level"]),
                "record": self.records[one.record].name,
            }
            for family, value in labels.items():
                found.append(Region(family, {family: value}, block.chi2, block.residual.size * per_row))
        return found

    def left(self, predicted: Sequence[Predicted]) -> list[RecordLeft]:
        """Of the fitted and of the held-out amplitudes of every record."""
        found = []
        for k, (record, noise, own) in enumerate(zip(self.records, self.noise, predicted)):
            for held in (False, True):
                rows = [np.arange(s.first, s.stop) for s in self.stretches if s.record == k and s.held == held]
                if not rows:
                    continue
                at = np.concatenate(rows)
                rest = record.amplitude_v[at] - own.amplitude_v[at]
                error = float(np.sqrt(np.mean((rest / noise.amplitude_v[at]) ** 2)))
                means = (float(np.mean(each**2)) for each in (rest, record.amplitude_v[at]))
                name = record.name if not held or record.role == "validate" else f"{record.name}, held out"
                left, power = means
                found.append(RecordLeft(name, "validate" if held else "fit", error, left, power, rest.size))
        return found
