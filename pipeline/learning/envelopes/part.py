"""Amplitudes of free decays as a part of a campaign.

Shapes: N rows, S senses; blocks (m, 1) as in ``rows``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Region, ResidualBlock, Signatures
from ...criticism.regression import Term
from ...device.model import Model
from ...errors import MeasurementError
from ...experiment.envelopes import EnvelopeRecord, settled_rows
from ...experiment.jumps import Jump
from ...experiment.noise.envelopes import EnvelopeNoise, envelope_noise
from ...experiment.tones import ToneCampaign
from ...inference.envelopes.model import EnvelopeModel, Predicted, floor_name
from ...inference.envelopes.start import modes_of_decays
from ...inference.tones.steps import damping_names, difference_step, lower_bound, slope
from ..joint.part import PartNoise, RecordLeft, Values, stacked_columns
from ..tones.terms import even_parameters, sizes_of
from .rows import EnvelopeRows

#: Stages that an amplitude shows.
_STAGES = frozenset({"mechanics", "force", "sense"})


@dataclass(frozen=True, eq=False)
class EnvelopePart:
    """The amplitudes of free decays of a campaign.

    Parameters
    ----------
    model, full : the given one, and with every term.
    campaign : its records.
    even : parameters of which ``values`` hold the squares.
    """

    model: Model
    full: Model
    campaign: ToneCampaign
    even: frozenset[str] = frozenset()
    _cache: dict[tuple[float, ...], tuple[Predicted, ...]] = field(default_factory=dict)

    kind = "envelopes"

    @cached_property
    def records(self) -> tuple[EnvelopeRecord, ...]:
        """The rows that are used."""
        return tuple(settled_rows(record) for record in self.campaign.envelopes)

    @cached_property
    def row_noise(self) -> tuple[EnvelopeNoise, ...]:
        """sd of every row."""
        return tuple(envelope_noise(record) for record in self.records)

    @cached_property
    def rows(self) -> EnvelopeRows:
        """The records as rows."""
        return EnvelopeRows(self.records, self.row_noise)

    @cached_property
    def noise(self) -> PartNoise:
        """Far above the floor."""
        own = self.row_noise
        sigma = np.sqrt(np.mean([one.floor_v**2 for one in own], axis=0))
        declared = all(one.declared for one in own)
        dof = np.inf if declared else float(sum(5 * one.windows for one in own))
        return PartNoise(tuple(sigma.tolist()), "declared" if declared else "local", dof, True, declared)

    @property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The stretches."""
        return self.rows.measured

    @property
    def jumps(self) -> tuple[Jump, ...]:
        """None: these are no sweeps."""
        return ()

    @property
    def held(self) -> int:
        """Stretches held out."""
        return self.rows.held

    @property
    def strata(self) -> tuple[IntArray, ...]:
        """One for all rows."""
        return tuple(np.zeros(block.residual.size, dtype=np.int64) for block in self.measured[: len(self.rows.fitted)])

    @cached_property
    def effects(self) -> tuple[str, ...]:
        """Those of the motion and of the pick-off; a force law with coordinates of its own has no slow flow of one mode."""
        library = self.model.library
        found = (name for name in self.model.candidates() if set(library[name].stages) & _STAGES)
        return tuple(name for name in found if not library[name].has_coordinates)

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
        """None: the floor is always free."""
        return ()

    @property
    def shows_gains(self) -> int:
        """0: nothing states the force."""
        return 0

    @cached_property
    def envelope(self) -> EnvelopeModel:
        """The records as a function of the parameters of all terms."""
        campaign = self.campaign
        return EnvelopeModel(
            self.full,
            self.records,
            self.row_noise,
            self.rows.fitted_rows,
            campaign.instrument,
            campaign.angular_gain,
            self.even,
        )

    def plant_start(self) -> dict[str, float]:
        """From the slopes of the records; gains do not matter."""
        modes, plant = modes_of_decays(self.records, self.row_noise), self.model.plant
        if plant.kind != "modal" or len(modes) < plant.modes:
            raise MeasurementError(
                "amplitudes alone do not show the modes of the plant",
                value=f"{len(modes)} modes, plant {plant.kind!r}",
                allowed='plant = { kind = "modal", modes = .. } with the modes that the records are tuned to',
                next_step="correct modes in the model file, or add a sweep or time records to the campaign",
            )
        return {name: value for k, (f, z) in enumerate(modes, 1) for name, value in ((f"f{k}_hz", f), (f"zeta{k}", z))}

    def own_start(self, values: Values) -> dict[str, float]:
        """The floors that the scatter shows."""
        return {
            floor_name(k, s): min(float(noise.floor_v[s]), 0.7 * float(record.amplitude_v[:, s].min()))
            for k, (record, noise) in enumerate(zip(self.records, self.row_noise))
            for s in range(record.amplitude_v.shape[1])
        }

    def fixed(self) -> dict[str, float]:
        """The frequencies of modes of which only amplitudes are known, and all gains."""
        found = {name: 1.0 for name in self.model.by_name if name.startswith("gain")}
        if any(record.shows_frequency for record in self.records) or self.model.plant.kind != "modal":
            return found
        return found | {name: value for name, value in self.plant_start().items() if name.endswith("_hz")}

    def sizes(self, names: Sequence[str], values: Values) -> dict[str, float]:
        """By trial."""
        return sizes_of(self, [name for name in names if name in self.effects], values)

    def nearby(self, values: Values) -> Callable[[Values], tuple[FloatArray, ...]]:
        """The rows at other values."""
        return self.predict

    def even_parameters(self, sizes: Values, values: Values) -> frozenset[str]:
        """By trial."""
        return even_parameters(self, sizes, values)

    def with_full(self, full: Model) -> EnvelopePart:
        """The part for the model with every term."""
        return replace(self, full=full, _cache={})

    def with_even(self, even: frozenset[str]) -> EnvelopePart:
        """The part for squares of the parameters ``even``."""
        return replace(self, even=even, _cache={})

    def mode_grid(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """None: an amplitude shows one mode."""
        return (), ()

    def predict(self, values: Values) -> tuple[FloatArray, ...]:
        """The stretches of a device."""
        return self.rows.of(self.predicted(values))

    def predicted(self, values: Values) -> tuple[Predicted, ...]:
        """Every record; the last ones are kept."""
        at = {**dict.fromkeys(self.own_start(values), 0.0), **values}
        key = tuple(at[name] for name in sorted(at))
        if key not in self._cache:
            if len(self._cache) > 8:
                self._cache.clear()
            self._cache[key] = self.envelope.predict(at)
        return self._cache[key]

    def slopes(self, values: Values, names: Sequence[str], sizes: Values) -> list[FloatArray]:
        """By differences, in which the free states follow."""
        own = {**sizes, **self.own_start(values)}
        zetas, columns = damping_names(self.full), []
        for name in names:
            if (name not in self.full.by_name and name not in own) or name in self._unseen:
                columns.append(tuple(np.zeros(block.residual.shape) for block in self.measured))
                continue
            step = difference_step(zetas, name, values, own.get(name, 1.0))
            columns.append(slope(self.predict, values, name, step, lower_bound(self.full, self.even, name)))
        return stacked_columns(columns, self.measured)

    @cached_property
    def _unseen(self) -> frozenset[str]:
        """Parameters that never act here: gains, and those of effects of other stages."""
        others = (e for e in self.full.ordered_effects() if not set(e.stages) & _STAGES)
        names = {name for e in others for name in self.full.parameters_of(e.name)}
        return frozenset(names | {name for name in self.full.by_name if name.startswith("gain")})

    def probes(self, values: Values) -> Signatures:
        """Shapes of the predicted decays."""
        return self.rows.probes(self.predicted(values))

    def regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """By time."""
        return self.rows.regions(blocks, per_row)

    def misfit_regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """By time, level and record."""
        return self.rows.misfit_regions(blocks, per_row)

    def left(self, values: Values) -> list[RecordLeft]:
        """Of the amplitudes."""
        return self.rows.left(self.predicted(values))
