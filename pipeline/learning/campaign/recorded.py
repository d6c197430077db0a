"""What a problem must say of its records in the time domain, so that they may differ from each other.

A campaign of time records alone is one such problem, a campaign of several domains another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, Self

from ...criticism.problem import FitResult, Problem
from ...device.model import Model
from ...experiment.noise.level import NoiseLevel
from ...experiment.record import Campaign
from ...inference.general.fit import CampaignFit
from ...inference.general.variation import RecordVariation
from ...inference.screening.dependent_noise import DependentNoise


class RecordedProblem(Problem, Protocol):
    """A problem with records in the time domain."""

    @property
    def model(self) -> Model:
        """The given one."""
        ...

    @property
    def campaign(self) -> Campaign:
        """The records in time, corrected where they differ."""
        ...

    @property
    def measured(self) -> Campaign:
        """The records in time as they were measured."""
        ...

    @property
    def noise(self) -> NoiseLevel:
        """Of the records in time."""
        ...

    @property
    def threads(self) -> int:
        """Records that are integrated in parallel."""
        ...

    @property
    def variation(self) -> RecordVariation | None:
        """For which ``campaign`` was corrected."""
        ...

    @property
    def dependent(self) -> DependentNoise | None:
        """Noise that depends on the signal and is contained in ``noise``."""
        ...

    @property
    def curved(self) -> frozenset[str]:
        """As of ``curved.curved_terms``."""
        ...

    def campaign_fit(self, terms: Sequence[str]) -> CampaignFit:
        """The records in time beside the fit with these terms, which ``fit`` made before."""
        ...

    def fitted_names(self, fit: FitResult) -> tuple[str, ...]:
        """The parameters that were fitted, in the order of the first columns of the Jacobian of ``fit``."""
        ...

    def with_records(
        self,
        campaign: Campaign,
        noise: NoiseLevel,
        corrected: tuple[Campaign, RecordVariation] | None = None,
        dependent: DependentNoise | None = None,
        curved_starts: Mapping[str, float] | None = None,
    ) -> Self:
        """The problem with other records in time; ``corrected`` are the measured ones and their variation."""
        ...
