"""A campaign of several domains, one of which is time, as a ``Problem`` of criticism.

Records in time bring what the other domains do not have: disturbances, whose amplitudes are free in every record and channel.
A disturbance is projected out of the rows of the records, so that a fit with it has rows of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

from ...criticism.problem import FitResult, Signatures
from ...device.model import Model
from ...experiment.tones import ToneCampaign
from ..timed.part import TimePart
from .part import Part
from .parts import parts_of
from .problem import JointProblem
from .rows import JointRows


def joint_problem(campaign: ToneCampaign, model: Model) -> JointProblem:
    """The problem of a campaign whose records are not all in the time domain.

    Raises
    ------
    ConfigError, MeasurementError : as of ``parts_of``.
    """
    parts = parts_of(campaign, model)
    return MixedProblem(parts, parts[0]) if isinstance(parts[0], TimePart) else JointProblem(parts)


class MixedProblem(JointProblem):
    """The problem of a campaign with records in the time domain, ``time``, which is the first of its ``parts``."""

    def __init__(self, parts: tuple[Part, ...], time: TimePart) -> None:
        super().__init__(parts)
        self.time = time
        self._rows: dict[frozenset[str], JointRows] = {}

    def rows_of(self, terms: Sequence[str], start: FitResult | None = None) -> JointRows:
        """The rows without the disturbances among ``terms``, in the shape that the residuals of the first such fit support."""
        own = frozenset(terms) & frozenset(self.time.disturbances)
        if own not in self._rows:
            values, time = self._at_null if start is None else self.values(start), self.time
            for name in sorted(own):
                time = time.with_disturbance(name, values)
            self._rows[own] = replace(self.rows, parts=(time, *self.rows.parts[1:])) if own else self.rows
        return self._rows[own]

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """Absent effects that do not change these records."""
        return tuple(name for name in super().unseen if name not in self.time.disturbances)

    def time_of(self, terms: Sequence[str]) -> TimePart:
        """The records in time beside the disturbances among ``terms``."""
        part = self.rows_of(terms).parts[0]
        assert isinstance(part, TimePart)
        return part

    def signatures(self, fit: FitResult) -> Signatures:
        """Those of all parts, and disturbances of the records in time."""
        local = self.time_of(fit.terms).disturbance_candidates(self.values(fit))
        return replace(super().signatures(fit), local=local)

    def _completed(self, fit: FitResult) -> FitResult:
        found, own = super()._completed(fit), [term for term in fit.terms if term in self.time.disturbances]
        model = self.time_of(fit.terms).model
        shapes = {name: (model.fixed[name], 0.0) for term in own for name in sorted(model.parameters_of(term))}
        none: dict[str, tuple[()]] = dict.fromkeys(own, ())
        return replace(
            found,
            parameters={**found.parameters, **shapes},
            columns={**found.columns, **none},
            shifts={**found.shifts, **none},
        )
