"""A check of the declared DAC hold: a wrong one appears as a lag or a feedthrough that does not exist.

Between two samples a wrong hold is late, or too weak, in a way that grows with frequency; some read-out effects do the same
(``Effect.mimics_hold``).  The model without these effects is fitted with every other hold.  If one of them explains the fit
records better than the declared hold does with the effects, the declared hold is probably wrong.
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

#: Samples of each fit record that are used, from its start.
_SAMPLES = 12_000
#: Relative error of a better hold, as a share of that of the declared one.
_BETTER = 0.95


@dataclass(frozen=True)
class HoldHint:
    """Another hold explains the records better than the declared one.

    Parameters
    ----------
    declared, likely : the two holds.
    look_alikes : effects that mimic a wrong hold; they are in the model with ``declared``, but not in that with ``likely``.
    error, error_declared : rms(measured - model) / rms(measured) with ``likely`` and with ``declared``.
    """

    declared: Hold
    likely: Hold
    look_alikes: tuple[str, ...]
    error: float
    error_declared: float

    def __str__(self) -> str:
        without = f", without {', '.join(self.look_alikes)}, which mimic a wrong hold" if self.look_alikes else ""
        return (
            f'the declared hold = "{self.declared}" is probably wrong: hold = "{self.likely}" explains the records better'
            f" (relative error {self.error:.3g} instead of {self.error_declared:.3g}){without};"
            " check the DAC hold, correct [instrument] hold and run again"
        )


def hold_hint(fit: CampaignFit, campaign: Campaign, given: Sequence[str] = ()) -> HoldHint | None:
    """A hold that explains the fit records clearly better than the declared one does; ``None`` if there is none.

    Parameters
    ----------
    fit : the model at the end of the selection.
    campaign : its records.
    given : effects that the user put into the model; they are kept.
    """
    look_alikes = hold_look_alikes(fit, given)
    used = replace(campaign, records=tuple(_beginning(record) for record in campaign.with_role("fit")))
    model = _without(fit.model, _selected_forces(fit, given))
    reduced = _without(model, look_alikes)
    declared = _error(model, used, fit)
    others = {hold: _error(reduced, _with_hold(used, hold), fit) for hold in HOLDS if hold != campaign.instrument.hold}
    likely = min(others, key=lambda hold: others[hold])
    if not others[likely] < _BETTER * declared:
        return None
    return HoldHint(campaign.instrument.hold, likely, look_alikes, others[likely], declared)


def hold_look_alikes(fit: CampaignFit, given: Sequence[str] = ()) -> tuple[str, ...]:
    """Effects of a fit that mimic a wrong hold and that the user did not put into the model."""
    return tuple(e.name for e in fit.model.ordered_effects() if e.mimics_hold and e.name not in given)


def _selected_forces(fit: CampaignFit, given: Sequence[str]) -> tuple[str, ...]:
    """Force laws of a gyro that the selection added: they do not hide a wrong hold, and take a minute to refit."""
    if fit.model.plant.kind != "gyro":
        return ()
    return tuple(e.name for e in fit.model.ordered_effects() if e.force is not None and e.name not in given)


def _without(model: Model, names: Sequence[str]) -> Model:
    for name in names:
        model = model.without_effect(name)
    return model


def _beginning(record: Record) -> Record:
    return replace(record, drive_v=record.drive_v[:_SAMPLES].copy(), sense_v=record.sense_v[:_SAMPLES].copy())


def _with_hold(campaign: Campaign, hold: Hold) -> Campaign:
    return replace(campaign, instrument=replace(campaign.instrument, hold=hold))


def _error(model: Model, campaign: Campaign, fit: CampaignFit) -> float:
    """Relative error of ``model`` on the fit records, fitted from the values of ``fit``; infinite if the fit fails."""
    start = {name: value for name, value in fit.values.items() if name in model.by_name}
    try:
        found = fit_campaign(model, campaign, fit.noise.beginning(_SAMPLES), start).relative_error["fit"]
    except (GyroscreenError, np.linalg.LinAlgError):
        found = None
    return np.inf if found is None else found
