"""Frequency-domain records as rows: the real and the imaginary part of every row and channel, in units of its sd.

One block for each pass of a sweep (rows of one level and direction) and for each drive of a frequency response; fitted passes
first, then those held out.  Rows beside a jump of the response are left out (``experiment.jumps``).

Shapes: N rows of a record, n rows of a pass, S senses; a block is (n, 2 S): real parts of the senses, then imaginary ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import BoolArray, ComplexArray, FloatArray, IntArray
from ...criticism.problem import Candidate, Region, ResidualBlock, Signatures, TermParameter
from ...experiment.jumps import Jump, jump_rows, jumps_of
from ...experiment.noise.tones import ToneNoise
from ...experiment.tones import SweepPass, ToneCampaign, passes_of
from ...inference.general.resonances import resonances_of

#: Bands of the rows in which the residual of each pass is tested and listed.
_BANDS = 8
#: Highest order of the polynomials of the generic shapes.
_SHAPES = 3


@dataclass(frozen=True, eq=False)
class ToneRows:
    """The rows of a campaign at a noise level; ``width_hz`` is zeta f0 of its narrowest resonance."""

    campaign: ToneCampaign
    noise: ToneNoise
    width_hz: float

    @cached_property
    def passes(self) -> tuple[SweepPass, ...]:
        """The fitted passes, then those held out."""
        found = passes_of(self.campaign.records)
        held = [one for one in found if self.campaign.records[one.record].role == "validate"]
        return (*(one for one in found if one not in held), *held)

    @property
    def held(self) -> int:
        """Number of passes held out."""
        return sum(self.campaign.records[one.record].role == "validate" for one in self.passes)

    @property
    def fitted(self) -> tuple[SweepPass, ...]:
        """The fitted passes."""
        return self.passes[: len(self.passes) - self.held]

    @cached_property
    def jumping(self) -> tuple[BoolArray, ...]:
        """For each pass (rows of the pass,) whether a row is beside a jump."""
        records = self.campaign.records
        return tuple(
            jump_rows(records[one.record], one, self.width_hz, self.noise.sd_v[one.record]) for one in self.passes
        )

    @property
    def jumps(self) -> tuple[Jump, ...]:
        """The rows that are left out."""
        every = (jumps_of(self.campaign.records[p.record], p, own) for p, own in zip(self.passes, self.jumping))
        return tuple(jump for own in every for jump in own)

    @cached_property
    def kept(self) -> tuple[IntArray, ...]:
        """For each pass (n,) its rows in the record."""
        return tuple(one.first + np.flatnonzero(~own) for one, own in zip(self.passes, self.jumping))

    def kept_of(self, record: int) -> IntArray:
        """(n,) the rows of a record."""
        return np.concatenate([own for one, own in zip(self.passes, self.kept) if one.record == record])

    def whitened(self, y: Sequence[ComplexArray]) -> tuple[FloatArray, ...]:
        """For each pass (n, 2 S) [sigma] of values (N, S) [V] of every record."""
        found = []
        for one, rows in zip(self.passes, self.kept):
            own, sd = y[one.record][rows], self.noise.sd_v[one.record][rows]
            found.append(np.concatenate([own.real / sd, own.imag / sd], axis=1))
        return tuple(found)

    def name(self, one: SweepPass) -> str:
        """Record, number of the pass in it, and direction; only the record where it has a single pass."""
        record = self.campaign.records[one.record].name
        own = sorted(other.first for other in self.passes if other.record == one.record)
        return record if len(own) == 1 else f"{record}, pass {own.index(one.first) + 1} ({one.direction})"

    @cached_property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The measured passes as blocks, in units of their sd."""
        rows = self.whitened([record.sense_v for record in self.campaign.records])
        swept = [self.campaign.records[one.record].kind == "sweep" for one in self.passes]
        return tuple(
            ResidualBlock(
                self.name(one),
                own,
                {"level": f"{one.level:.2g}", "direction": one.direction, "drives": one.drives} if sweep else {},
            )
            for one, own, sweep in zip(self.passes, rows, swept)
        )

    @cached_property
    def strata(self) -> tuple[IntArray, ...]:
        """For each fitted pass (2 S n,) zeros: the passes of a sweep are too short for strata of their own."""
        return tuple(np.zeros(block.residual.size, dtype=np.int64) for block in self.measured[: len(self.fitted)])

    def probes(self, prediction: Sequence[ComplexArray]) -> Signatures:
        """Generic shapes of a fitted ``prediction`` (N, S) of every record: Y times complex polynomials, and |Y|^2 Y.

        They resemble a wrong resonance, a wrong gain, and a response that depends on its own size.
        """
        f = np.concatenate([record.frequency_hz for record in self.campaign.records])
        middle, half = 0.5 * (f.max() + f.min()), max(0.5 * float(np.ptp(f)), 1e-300)
        largest = max(float(np.abs(y).max(initial=0.0)) for y in prediction) or 1.0
        shapes: dict[str, list[list[ComplexArray]]] = {"response": [], "background": [], "size of the response": []}
        for order in range(_SHAPES + 1):
            powers = [((r.frequency_hz - middle) / half)[:, None] ** order for r in self.campaign.records]
            shapes["response"].append([y * p for y, p in zip(prediction, powers)])
            shapes["background"].append([np.ones_like(y) * p for y, p in zip(prediction, powers)])
        shapes["size of the response"].append([y * np.abs(y / largest) ** 2 for y in prediction])
        candidates, columns, first = [], [], 0
        for name, each in shapes.items():
            own = [self.whitened([turn * y for y in shape]) for shape in each for turn in (1.0, 1.0j)]
            columns += own
            parameters = tuple(TermParameter(f"{name} {i}") for i in range(len(own)))
            candidates.append(Candidate(name, parameters, (slice(first, first + len(own)),)))
            first += len(own)
        blocks = (np.stack([column[b].reshape(-1) for column in columns], axis=1) for b in range(len(self.fitted)))
        return Signatures(tuple(candidates), tuple(blocks))

    @cached_property
    def bands_hz(self) -> FloatArray:
        """Edges (B + 1,) [Hz] of the bands of the fitted rows; the same for all passes, whose residuals add up by band."""
        f = np.concatenate(
            [self.campaign.records[p.record].frequency_hz[rows] for p, rows in zip(self.fitted, self.kept)]
        )
        edges = np.unique(np.quantile(f, np.linspace(0.0, 1.0, _BANDS + 1)))
        edges[-1] = np.nextafter(edges[-1], np.inf)
        return np.asarray(edges)

    def regions(self, blocks: Sequence[ResidualBlock], values: Mapping[str, float], per_row: float) -> list[Region]:
        """The residual ``blocks`` of the fitted passes, by channel in bands of the rows: of a resonance and beside."""
        modes = resonances_of(values)
        edges = self.bands_hz
        found: list[Region] = []
        for one, rows, block in zip(self.fitted, self.kept, blocks):
            f = self.campaign.records[one.record].frequency_hz[rows]
            band = np.searchsorted(edges, f, side="right") - 1
            for k in np.unique(band).tolist():
                part, low, high = np.flatnonzero(band == k), float(edges[k]), float(edges[k + 1])
                centre, wide = 0.5 * (low + high), high - low
                near = any(abs(centre - mode) < 2.0 * max(width, wide) for mode, width in modes)
                for channel in range(block.residual.shape[1] // 2):
                    own = block.residual[part][:, [channel, channel + block.residual.shape[1] // 2]]
                    labels = {
                        "record": block.name,
                        "channel": f"sense{channel + 1}",
                        "band_hz": [low, high],
                        "kind": "resonance" if near else "broadband",
                    }
                    found.append(Region("frequency", labels, float(np.sum(own**2)), own.size * per_row))
        return found

    def misfit_regions(
        self, blocks: Sequence[ResidualBlock], values: Mapping[str, float], per_row: float
    ) -> list[Region]:
        """``regions``, and the same residual by level, direction, channel and record."""
        found = self.regions(blocks, values, per_row)
        sums: dict[tuple[str, str], list[float]] = {}
        for one, block in zip(self.fitted, blocks):
            senses = block.residual.shape[1] // 2
            record = self.campaign.records[one.record]
            labels = {"record": record.name}
            if record.kind == "sweep":
                labels |= {"level": f"{one.level:.3g}", "direction": one.direction}
            for channel in range(senses):
                own = block.residual[:, [channel, channel + senses]]
                for family, value in {**labels, "channel": f"sense{channel + 1}"}.items():
                    total = sums.setdefault((family, value), [0.0, 0.0])
                    total[0] += float(np.sum(own**2))
                    total[1] += own.size * per_row
        for (family, value), (chi2, dof) in sums.items():
            label: dict[str, object] = {family: float(value) if family == "level" else value}
            found.append(Region(family, label, chi2, dof))
        return found
