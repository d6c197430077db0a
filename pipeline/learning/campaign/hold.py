"""Is the declared hold right?  A wrong one shows as a lag or a feedthrough that is not there.

Between two samples a hold that is not the true one is late, or too weak, in a way that grows with frequency: read-out effects
stand in for it.  The model less these effects is fitted with every other hold; if one of them explains the fitted records plainly
better than the declared hold does with the stand-ins, the declaration is doubtful.  Only the beginning of long records is asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...device.model import Model
from ...errors import GyroscreenError
from ...experiment.instrument import HOLDS, Hold
from ...experiment.record import Campaign, Record
from ...inference.general.fit import CampaignFit, fit_campaign

#: Samples of each fit record that are asked.
_ASKED = 12_000
#: Relative error of a better hold, as a share of that with the declared one.
_PLAINLY = 0.95


@dataclass(frozen=True)
class HoldHint:
    """``likely`` explains the records with relative error ``error``; ``declared`` and ``stand_ins`` with ``error_declared``."""

    declared: Hold
    likely: Hold
    stand_ins: tuple[str, ...]
    error: float
    error_declared: float

    def __str__(self) -> str:
        without = f", without {', '.join(self.stand_ins)}, which a wrong hold looks like" if self.stand_ins else ""
        return (
            f'the declared hold = "{self.declared}" is doubtful: hold = "{self.likely}" explains the records better'
            f" (relative error {self.error:.3g} against {self.error_declared:.3g}){without};"
            " ask how the drive samples become volts, correct [instrument] hold and run again"
        )


def hold_hint(fit: CampaignFit, campaign: Campaign, given: Sequence[str] = ()) -> HoldHint | None:
    """A better hold than the declared one, if there is one.

    Parameters
    ----------
    fit : the model at the end of the climb.
    campaign : its records.
    given : effects that the user put into the model; they are not doubted.
    """
    stand_ins = stand_ins_of(fit, given)
    asked = replace(campaign, records=tuple(_beginning(record) for record in campaign.with_role("fit")))
    model = _without(fit.model, _forces_of(fit, given))
    plain = _without(model, stand_ins)
    declared = _error(model, asked, fit)
    others = {hold: _error(plain, _held(asked, hold), fit) for hold in HOLDS if hold != campaign.instrument.hold}
    likely = min(others, key=lambda hold: others[hold])
    if not others[likely] < _PLAINLY * declared:
        return None
    return HoldHint(campaign.instrument.hold, likely, stand_ins, others[likely], declared)


def stand_ins_of(fit: CampaignFit, given: Sequence[str] = ()) -> tuple[str, ...]:
    """Effects of a fit that a wrong hold looks like and that the user did not put there."""
    return tuple(e.name for e in fit.model.ordered_effects() if e.mimics_hold and e.name not in given)


def _forces_of(fit: CampaignFit, given: Sequence[str]) -> tuple[str, ...]:
    """Force laws of a gyro that the climb put into the model: its hold shows without them, and they take a minute to refit."""
    if fit.model.plant.kind != "gyro":
        return ()
    return tuple(e.name for e in fit.model.ordered_effects() if e.force is not None and e.name not in given)


def _without(model: Model, names: Sequence[str]) -> Model:
    for name in names:
        model = model.without_effect(name)
    return model


def _beginning(record: Record) -> Record:
    return replace(record, drive_v=record.drive_v[:_ASKED].copy(), sense_v=record.sense_v[:_ASKED].copy())


def _held(campaign: Campaign, hold: Hold) -> Campaign:
    return replace(campaign, instrument=replace(campaign.instrument, hold=hold))


def _error(model: Model, campaign: Campaign, fit: CampaignFit) -> float:
    """Relative error of ``model`` on the records, from where ``fit`` stands; infinite where it cannot be fitted."""
    start = {name: value for name, value in fit.values.items() if name in model.by_name}
    try:
        found = fit_campaign(model, campaign, fit.noise, start).relative_error["fit"]
    except (GyroscreenError, np.linalg.LinAlgError):
        found = None
    return np.inf if found is None else found
