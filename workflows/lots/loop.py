"""compare, diagnose and refine for a measured lot, with calls as short as the commands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from msgspec import structs
from threadpoolctl import threadpool_limits

from pipeline.errors import UsageError
from pipeline.learning.lot.answers import LotComparisonAnswer, LotDiagnosisAnswer, LotRefinementAnswer
from pipeline.learning.lot.forecast import Conforms
from pipeline.learning.lot.loop import LotLadder, first_rung
from pipeline.learning.lot.population import nested_population
from pipeline.learning.lot.posterior import LotPosteriorAnswer, posterior
from pipeline.learning.lot.prepared import PreparedLot, prepared
from pipeline.learning.lot.respond import comparison, diagnosis, refinement
from pipeline.learning.lot.table import LotTable
from populations.spec import PopulationSpec, load_spec
from reports.limits import DEFAULT_LIMITS, Limits

from .judge import conforms_of
from .population import population_at, refined_spec

#: Fewer devices than this outside the held-out wafers cannot carry a population with a dozen spreads.
LEAST_FIT = 20


@dataclass(frozen=True, eq=False)
class LotAnswers:
    """A lot, its population and what they say; nothing is computed twice.

    Parameters
    ----------
    table : the lot.
    spec : its population file; ``None``: nested spreads of each quantity.
    limits : of gyros.
    without : irregularities that are no candidates.
    """

    table: LotTable
    spec: PopulationSpec | None
    limits: Limits = DEFAULT_LIMITS
    seed: int = 0
    without: tuple[str, ...] = ()

    @cached_property
    def ready(self) -> PreparedLot:
        """The lot with its population, ready for fits."""
        lot = self.table.lot
        fit = int((~lot.is_held).sum())
        if fit < LEAST_FIT:
            raise UsageError(
                "the lot has too few devices outside the wafers that are held out",
                value=fit,
                allowed=f"at least {LEAST_FIT}",
                next_step="give more devices, or [hold] share = 0 in lot.toml",
            )
        if self.spec is None:
            return prepared(lot, nested_population(lot))
        if not np.all(np.isfinite(lot.x_mm)):
            raise UsageError(
                "a population needs the place of each die on its wafer",
                value=int(np.sum(~np.isfinite(lot.x_mm))),
                allowed="die_x_mm and die_y_mm of every device [mm]",
                next_step="name their columns in lot.toml, or leave --population out",
            )
        return prepared(lot, population_at(self.spec, lot, self.table.stage))

    @property
    def conforms(self) -> Conforms | None:
        """What judges a device."""
        return conforms_of(self.table, self.limits, None if self.spec is None else self.spec.angular_gain)

    @cached_property
    def comparison(self) -> LotComparisonAnswer:
        """How well the population explains the lot."""
        with threadpool_limits(limits=1):
            return comparison(self.ready, self.seed)

    @cached_property
    def diagnosis(self) -> LotDiagnosisAnswer:
        """What the population lacks."""
        with threadpool_limits(limits=1):
            return diagnosis(self.ready, self.seed)

    @cached_property
    def _refined(self) -> tuple[LotRefinementAnswer, LotLadder]:
        with threadpool_limits(limits=1):
            return refinement(self.ready, self.conforms, self.seed, self.without)

    @property
    def refinement(self) -> LotRefinementAnswer:
        """The ladder."""
        return self._refined[0]

    @property
    def ladder(self) -> LotLadder:
        """The ladder with its fits."""
        return self._refined[1]

    def posterior(self, command: str, count: int) -> LotPosteriorAnswer:
        """Posterior of the ``count`` most influential spreads: of the refitted population, or of the last rung of refine."""
        with threadpool_limits(limits=1):
            rung = self.ladder.rungs[-1] if command == "refine" else first_rung(self.ready)
            return posterior(rung.fit, count, self.seed)

    @cached_property
    def refined_population(self) -> PopulationSpec | None:
        """The population file with the fitted spreads and the irregularities that were added; ``None`` without a file."""
        if self.spec is None:
            return None
        answer = self.refinement
        factors = {
            name: spread.ratio
            for part, spread in answer.spreads.items()
            for name in (spread.members or (part,))
            if "(" not in name
        }
        # A pattern of the other sign is no multiple of the file's; it is reported and left as it is.
        patterns = {part.name: part.members or (part.name,) for part in self.ladder.rungs[-1].fit.model.fixed}
        factors |= {
            name: pattern.ratio
            for part, pattern in answer.patterns.items()
            for name in patterns.get(part, ())
            if "(" not in name and pattern.ratio > 0.0
        }
        added = [name for name in answer.irregularities if "(" not in name and name != "outliers"]
        spec = refined_spec(self.spec, factors, added)
        return structs.replace(spec, name=f"{self.spec.name}, refined on {self.table.lot.name}")


def lot_answers(
    table: LotTable,
    spec: PopulationSpec | None = None,
    limits: Limits = DEFAULT_LIMITS,
    seed: int = 0,
    without: tuple[str, ...] = (),
) -> LotAnswers:
    """Answers about a lot; a gyro lot without ``spec`` is compared with the shipped population.

    Raises
    ------
    UsageError : a population file for a table of other quantities.
    """
    if spec is None and table.gyro:
        spec = load_spec(None)
    if spec is not None and not table.gyro:
        raise UsageError(
            "a population file describes gyros, and this table has other quantities",
            value=", ".join(table.lot.quantities)[:120],
            allowed="a lot with gyro = true",
            next_step="leave --population out: the generic irregularities work for any table",
        )
    return LotAnswers(table, spec, limits, seed, without)
