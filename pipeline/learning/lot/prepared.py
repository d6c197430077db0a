"""A lot ready for fits: the devices of each mixture told apart, held-out wafers set aside.

Shapes: n devices, q quantities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import BoolArray, FloatArray
from .measured import MeasuredLot
from .model import LotModel, means, merged, unit_of
from .outcome import HeldOut, held_out, members, with_curvature, with_mixture
from .population import DeviceMixture, LotPopulation, distinct
from .reml import LotFit, fitted

#: Passes in which the devices of a mixture are told apart, each with the spreads of the pass before; it ends when none changes.
#: Of 80 leaking lids of a lot (seed 4020 of the study) two passes found 61, and left devices 5.4 sd off among the sound ones.
PASSES = 8


@dataclass(frozen=True, eq=False)
class PreparedLot:
    """See the module.

    Parameters
    ----------
    measured : as read.
    population : that it is compared with.
    whole : with the linearization's covariance, and without the changes of the mixtures.
    mixtures : with the share that was found.
    leaking : mixture -> (n,) devices that belong to it.
    start : (C,) variances of the last fit that told them apart, where the next one starts.
    """

    measured: MeasuredLot
    population: LotPopulation
    whole: MeasuredLot
    mixtures: tuple[DeviceMixture, ...]
    leaking: dict[str, BoolArray]
    start: FloatArray

    @property
    def fit_lot(self) -> MeasuredLot:
        """The devices that fits may see."""
        return self.whole.subset(~self.whole.is_held)

    @property
    def in_mixture(self) -> BoolArray:
        """(n,) whether a device belongs to a mixture."""
        return np.any([np.zeros(len(self.whole.device), dtype=bool), *self.leaking.values()], axis=0)

    @property
    def log_share(self) -> FloatArray:
        """(n,) ln of the probability of each device's place in or outside the mixtures."""
        total = np.zeros(len(self.whole.device))
        for mixture in self.mixtures:
            total = total + np.where(self.leaking[mixture.name], np.log(mixture.share), np.log1p(-mixture.share))
        return total

    def fit(self, model: LotModel, start: FloatArray | None = None) -> LotFit:
        """Fit to the devices that fits may see; ``model`` lists all devices."""
        return fitted(self.fit_lot, model.subset(~self.whole.is_held), start)

    def outcome(self, model: LotModel, variances: FloatArray) -> HeldOut:
        """Errors and log scores, the shares of the mixtures included."""
        found = held_out(self.whole, model, variances)
        held, own = self.whole.is_held, self.log_share
        return replace(
            found,
            log_score_fit=found.log_score_fit + float(own[~held].mean()),
            log_score_validate=None
            if found.log_score_validate is None
            else found.log_score_validate + float(own[held].mean()),
        )


def free(model: LotModel) -> LotModel:
    """The model with a free mean of each quantity, patterns that are not combinations of others, and merged random parts."""
    n, q = model.offset.shape
    base = means(n, q)
    patterns = [part for part in model.fixed if part.name != base.name]
    return replace(
        model,
        fixed=(base, *distinct([base], patterns, unit_of(model.random))),
        random=merged(model.random),
    )


def prepared(lot: MeasuredLot, population: LotPopulation) -> PreparedLot:
    """The lot with its mixtures told apart: first by the population's own spreads, then by the fitted ones."""
    model = free(population.model)
    return sorted_out(lot, population, population.mixtures, model, np.ones(len(model.random)))


def sorted_out(
    lot: MeasuredLot,
    population: LotPopulation,
    mixtures: tuple[DeviceMixture, ...],
    model: LotModel,
    variances: FloatArray,
) -> PreparedLot:
    """The lot with the devices of ``mixtures`` told apart by ``model``, from ``variances`` on."""
    whole = clean = with_curvature(lot, population.curvature)
    leaking: dict[str, BoolArray] = {}
    found = list(mixtures)
    for _ in range(PASSES if mixtures else 0):
        clean, before = whole, dict(leaking)
        for k, mixture in enumerate(found):
            chosen = members(clean, model, variances, mixture)
            leaking[mixture.name] = chosen
            # At least half a device, so that a lot without one still may have one.
            found[k] = replace(mixture, share=float((chosen.sum() + 0.5) / (chosen.size + 1.0)))
            clean = with_mixture(clean, mixture, chosen)
        if before and all(np.array_equal(before[name], leaking[name]) for name in leaking):
            break
        held = clean.is_held
        variances = fitted(clean.subset(~held), model.subset(~held), np.maximum(variances, 1e-4)).variances
    return PreparedLot(lot, population, clean, tuple(found), leaking, variances)
