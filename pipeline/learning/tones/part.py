"""Sweeps and frequency responses as a part of a campaign.

Shapes: N rows, S senses; blocks (n, 2 S) as in ``rows``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...arrays import ComplexArray, FloatArray, IntArray
from ...criticism.problem import Region, ResidualBlock, Signatures, TermParameter
from ...criticism.regression import Term
from ...device.model import Model
from ...experiment.jumps import Jump
from ...experiment.noise.tones import tone_noise
from ...experiment.tones import ToneCampaign
from ...inference.modal.model import starting_values
from ...inference.tones.model import PHASE, SETTLING, SHARE, ToneModel, differences, offset_names
from ...inference.tones.start import LinearModes, linear_modes_of
from ..joint.part import PartNoise, RecordLeft, Values, stacked_columns
from .rows import ToneRows
from .terms import even_parameters, mode_grid, sizes_of, term_names


@dataclass(frozen=True, eq=False)
class TonePart:
    """The sweeps and frequency responses of a campaign.

    Parameters
    ----------
    model : the given one.
    full : with every term.
    campaign : its records.
    even : parameters of which ``values`` hold the squares.
    """

    model: Model
    full: Model
    campaign: ToneCampaign
    even: frozenset[str] = frozenset()

    kind = "tones"

    @cached_property
    def rows(self) -> ToneRows:
        """The records as rows."""
        modes = self.linear.record
        return ToneRows(
            self.campaign, tone_noise(self.campaign.records), float(np.min(modes.zeta * modes.frequency_hz))
        )

    @cached_property
    def tone(self) -> ToneModel:
        """The records as a function of the parameters of all terms."""
        return ToneModel(self.full, self.campaign, self.even)

    @cached_property
    def noise(self) -> PartNoise:
        """Of all rows."""
        own = self.rows.noise
        return PartNoise(tuple(own.sigma_v.tolist()), own.source, own.dof, own.known, own.independent)

    @property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The passes."""
        return self.rows.measured

    @property
    def jumps(self) -> tuple[Jump, ...]:
        """Of the sweeps."""
        return self.rows.jumps

    @property
    def held(self) -> int:
        """Passes held out."""
        return self.rows.held

    @property
    def strata(self) -> tuple[IntArray, ...]:
        """One for all rows."""
        return self.rows.strata

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """Those that act on a steady response."""
        return term_names(self.model, self.tone.swept)

    @property
    def refused(self) -> tuple[str, ...]:
        """Force laws with coordinates of their own."""
        return tuple(name for name, effect in self.model.library.items() if effect.has_coordinates)

    @property
    def ranged(self) -> tuple[str, ...]:
        """None: a size may be any."""
        return ()

    @property
    def levels(self) -> dict[str, tuple[float, ...]]:
        """None: an amplitude bends at a level, but has no flat peak."""
        return {}

    @property
    def own_terms(self) -> tuple[Term, ...]:
        """The settling of a detector."""
        return (Term(SETTLING, (TermParameter(SHARE, "1", 0.0, 1.0, 1),)),) if self.tone.swept else ()

    @cached_property
    def linear(self) -> LinearModes:
        """The modes of a linear fit."""
        plant = self.model.plant
        modes = 3 if plant.kind == "gyro" else plant.modes
        return linear_modes_of(self.campaign, modes, plant.kind == "modal" and plant.sense == "displacement")

    @property
    def shows_gains(self) -> int:
        """1: the lowest level of a sweep is nearly linear, but its phase is free."""
        return 1

    @cached_property
    def _plant(self) -> dict[str, float]:
        return starting_values(self.model, self.linear.record)

    def plant_start(self) -> dict[str, float]:
        """From the modes of a linear fit."""
        return dict(self._plant)

    def own_start(self, values: Values) -> dict[str, float]:
        """No offset; the phase of the linear fit, or for another start that in which the lowest level is most like the model."""
        plain = ToneModel(self.full, self.campaign)
        found = dict.fromkeys(plain.detector, 0.0)
        if PHASE in found and self._is_own(values):
            found[PHASE] = float(np.rad2deg(self.linear.phase))
        elif PHASE in found:
            at = {**{n: p.null for n, p in self.full.by_name.items()}, **values, **found}
            total = 0.0j
            for record, y in zip(self.campaign.records, plain.linear(at)):
                lowest = record.level_v <= 1.001 * record.level_v.min()
                if record.kind == "sweep":
                    total += np.vdot(y[lowest], record.sense_v[lowest])
            found[PHASE] = float(np.rad2deg(np.angle(total)))
        return found

    def _is_own(self, values: Values) -> bool:
        """Whether the plant of ``values`` is that of these records."""
        return "_plant" in self.__dict__ and all(values.get(name) == value for name, value in self._plant.items())

    def fixed(self) -> dict[str, float]:
        """None: a response shows every parameter."""
        return {}

    def sizes(self, names: Sequence[str], values: Values) -> dict[str, float]:
        """By trial."""
        return sizes_of(self, [name for name in names if name in self.effects], values)

    def even_parameters(self, sizes: Values, values: Values) -> frozenset[str]:
        """By trial."""
        return even_parameters(self, sizes, values)

    def with_full(self, full: Model) -> TonePart:
        """The part for the model with every term."""
        return replace(self, full=full)

    def with_even(self, even: frozenset[str]) -> TonePart:
        """The part for squares of the parameters ``even``."""
        return replace(self, even=even)

    def mode_grid(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Within the rows."""
        return mode_grid(self.campaign)

    def nearby(self, values: Values) -> Callable[[Values], tuple[ComplexArray, ...]]:
        """Y (N, S) [V] of every record at values close to these."""
        return self.tone.nearby(values)

    def predict(self, values: Values) -> tuple[FloatArray, ...]:
        """The passes of a device."""
        return self.rows.whitened(self.tone.predict(values))

    def predicted(self, values: Values) -> tuple[ComplexArray, ...]:
        """Y (N, S) [V] of every record."""
        return self.tone.predict(values)

    def slopes(self, values: Values, names: Sequence[str], sizes: Values) -> list[FloatArray]:
        """By central differences on the branch of the motion."""
        own = dict.fromkeys(offset_names(self.campaign.records[0].sense_v.shape[1]), 0.001 * self._largest)
        columns = [
            self.rows.whitened(one) for one in differences(self.tone, values, names, {**sizes, **own, PHASE: 1.0})
        ]
        return stacked_columns(columns, self.measured)

    @property
    def _largest(self) -> float:
        return max(float(np.abs(record.sense_v).max()) for record in self.campaign.records)

    def probes(self, values: Values) -> Signatures:
        """Shapes of the predicted response."""
        return self.rows.probes(self.predicted(values))

    def regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """By frequency."""
        return self.rows.regions(blocks, values, per_row)

    def misfit_regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """By frequency, level, direction, channel and record."""
        return self.rows.misfit_regions(blocks, values, per_row)

    def left(self, values: Values) -> list[RecordLeft]:
        """Of every record, X and Y together."""
        found = []
        for k, (record, y, sd) in enumerate(zip(self.campaign.records, self.predicted(values), self.rows.noise.sd_v)):
            rows = self.rows.kept_of(k)
            measured = record.sense_v[rows]
            rest = measured - y[rows]
            error = float(np.sqrt(np.mean(np.abs(rest / sd[rows]) ** 2) / 2.0))
            left, power = (float(np.mean(np.abs(each) ** 2)) for each in (rest, measured))
            found.append(RecordLeft(record.name, str(record.role or "fit"), error, left, power, measured.size))
        return found
