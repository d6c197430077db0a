"""A part of a campaign: its records of one domain as rows that a model predicts.

    time       samples, as Fourier coefficients              (``learning.timed``)
    tones      sweeps and frequency responses, row by row    (``learning.tones``)
    envelopes  amplitude of a free decay against time        (``learning.envelopes``)

All parts have one device and one set of its parameters.  Each has its own noise, and parameters of its own instrument, such as
the phase of a detector.  Blocks are in units of the noise, fitted ones first, then those held out.

Shapes: block b (n_b, m_b); K parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from ...arrays import FloatArray, IntArray
from ...criticism.problem import Region, ResidualBlock, Signatures
from ...criticism.regression import Term
from ...device.model import Model
from ...experiment.jumps import Jump

Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class PartNoise:
    """Noise of a part: rms ``sigma_v`` by channel [V], its source, and its degrees of freedom.

    known : it was measured, else it is only bounded; independent : on other data than the rows themselves.
    """

    sigma_v: tuple[float, ...]
    source: str
    dof: float
    known: bool
    independent: bool


@dataclass(frozen=True)
class RecordLeft:
    """What a model leaves of a record: error [sigma]; mean squares of the rest and of the record [V^2], over ``size`` values."""

    name: str
    role: str
    error: float
    left: float
    power: float
    size: int


class Part(Protocol):
    """The records of one domain beside a device."""

    @property
    def model(self) -> Model:
        """The given model, with the channels of the records."""
        ...

    @property
    def full(self) -> Model:
        """The model with every term."""
        ...

    @property
    def kind(self) -> str:
        """Name of the domain, as in the head of this module."""
        ...

    @property
    def noise(self) -> PartNoise:
        """Of all records."""
        ...

    @property
    def measured(self) -> tuple[ResidualBlock, ...]:
        """The measured rows in units of the noise."""
        ...

    @property
    def jumps(self) -> tuple[Jump, ...]:
        """Rows that are left out beside a jump of the response."""
        ...

    @property
    def held(self) -> int:
        """Number of blocks held out."""
        ...

    @property
    def strata(self) -> tuple[IntArray, ...]:
        """For each fitted block (n m,) the noise stratum of a row, from 0."""
        ...

    @property
    def effects(self) -> tuple[str, ...]:
        """Absent effects that could act on these records."""
        ...

    @property
    def refused(self) -> tuple[str, ...]:
        """Effects with which these records cannot be predicted, so that they are no candidates for a device that has them."""
        ...

    @property
    def ranged(self) -> tuple[str, ...]:
        """Parameters that must stay in their ranges, which are at the scale of these records."""
        ...

    @property
    def levels(self) -> Mapping[str, tuple[float, ...]]:
        """Parameter that is the inverse of a clip level -> values to try; empty where the records show no clipping."""
        ...

    @property
    def own_terms(self) -> tuple[Term, ...]:
        """Terms of the instrument."""
        ...

    @property
    def shows_gains(self) -> int:
        """How well the records show the plant and its gains; the start values are those of the part that shows them best."""
        ...

    def plant_start(self) -> dict[str, float]:
        """Start values of the plant from these records alone; raises MeasurementError where they do not show it."""
        ...

    def own_start(self, values: Values) -> dict[str, float]:
        """Start values of the parameters of the instrument for a device with ``values``."""
        ...

    def fixed(self) -> dict[str, float]:
        """Plant parameters that these records cannot show, at the values that they state or that do not matter."""
        ...

    def sizes(self, names: Sequence[str], values: Values) -> dict[str, float]:
        """Parameters of the effects ``names`` that change these records at ``values`` -> the size that does so by about 1e-3."""
        ...

    def even_parameters(self, sizes: Values, values: Values) -> frozenset[str]:
        """Of the parameters with a size those whose sign does not show."""
        ...

    def with_full(self, full: Model) -> Self:
        """The part for the model ``full`` with every term."""
        ...

    def with_even(self, even: frozenset[str]) -> Self:
        """The part for values that hold the squares of the parameters ``even``."""
        ...

    def mode_grid(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Frequencies [Hz] and damping ratios of an additional mode that the records resolve."""
        ...

    def predict(self, values: Values) -> tuple[FloatArray, ...]:
        """The blocks of a device with ``values``; raises GyroscreenError where no device has them."""
        ...

    def slopes(self, values: Values, names: Sequence[str], sizes: Values) -> list[FloatArray]:
        """For each block d block / d parameter (n m, K)."""
        ...

    def probes(self, values: Values) -> Signatures:
        """Generic shapes that a misfit is likely to resemble."""
        ...

    def regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """Small regions of the fitted residual ``blocks`` with ``per_row`` degrees of freedom of a row, for tests."""
        ...

    def misfit_regions(self, blocks: Sequence[ResidualBlock], values: Values, per_row: float) -> list[Region]:
        """The families of the answer."""
        ...

    def left(self, values: Values) -> list[RecordLeft]:
        """Errors of every record."""
        ...


def model_with(model: Model, names: Sequence[str]) -> Model:
    """The model with the effects ``names``; at their nulls they do nothing."""
    for name in names:
        model = model.with_effect(name)
    return model


def stacked_columns(columns: Sequence[Sequence[FloatArray]], measured: Sequence[ResidualBlock]) -> list[FloatArray]:
    """For each block its columns (n m, K), from K derivatives that each hold one array (n, m) for every block."""
    return [
        np.stack([column[b].reshape(-1) for column in columns], axis=1)
        if columns
        else np.zeros((block.residual.size, 0))
        for b, block in enumerate(measured)
    ]
