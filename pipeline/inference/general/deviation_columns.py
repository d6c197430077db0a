"""Derivatives of records with respect to their deviations from each other.

    C_k = d f_k / d (phi, tau, g_1 .., b_1 ..)            of a record k at parameters x

Shapes: R records of a drive group, N samples, S senses, m deviations of a record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...arrays import FloatArray
from ...device.model import Model
from ...experiment.forward.drive_groups import DriveGroup, drive_groups_of, highest_drive_energy
from ...experiment.forward.response import (
    Starts,
    converted,
    delayed,
    linear_volts,
    nonlinear_responses,
    nonlinear_share,
)
from ...experiment.forward.sensitivity import SLOPE_SUBSTEPS
from ...experiment.forward.system import System, assemble
from ...experiment.instrument import Instrument
from ...experiment.record import Campaign, Record
from .fit import CampaignFit
from .gauss_newton import FAINT

#: (system, drive group, initial states, additional delays [s]) -> (delays, R, N, S) [V]
Respond = Callable[[System, DriveGroup, Starts, Sequence[float]], FloatArray]

#: Relative step of the frequency derivative: an eighth of a line width at a quality factor of 60,000.
_STEP = 1e-6


def at_frequency(model: Model, values: Mapping[str, float], phi: float) -> dict[str, float]:
    """Complete parameter ``values`` with every natural frequency of the plant times 1 + phi."""
    own = {p.name for p in model.built.parameters if p.unit == "Hz"}
    return {name: value * (1.0 + phi) if name in own else value for name, value in values.items()}


def response_for(fit: CampaignFit, campaign: Campaign) -> Respond:
    """The response whose changes with the deviations are right to 0.1 %: linear where nonlinear effects are faint.

    Changes need fewer substeps of the integrator than the records themselves.
    """
    fitted = campaign.with_role("fit")
    strongest = fitted[highest_drive_energy([record.drive_v for record in fitted])]
    ((_, group),) = drive_groups_of([strongest], campaign.instrument, campaign.angular_gain)
    system = assemble(fit.model, fit.values, campaign.instrument, group.conditions)
    faint = nonlinear_share(system, group) < FAINT

    def respond(system: System, group: DriveGroup, starts: Starts, delays_s: Sequence[float]) -> FloatArray:
        y = np.stack([linear_volts(delayed(system, delay_s), group, starts) for delay_s in delays_s])
        if not faint:
            y += nonlinear_responses(system, group, starts, SLOPE_SUBSTEPS, delays_s)
        return converted(system, y)

    return respond


def _deviation_columns(
    model: Model,
    values: Mapping[str, float],
    group: DriveGroup,
    instrument: Instrument,
    starts: Starts,
    respond: Respond,
) -> FloatArray:
    """C (R, m, N, S) [V per unit] of the records of a drive group at complete ``values``."""
    up, down = (
        respond(assemble(model, at_frequency(model, values, phi), instrument, group.conditions), group, starts, (0.0,))[
            0
        ]
        for phi in (_STEP, -_STEP)
    )
    system = assemble(model, values, instrument, group.conditions)
    # A thousandth of a sample: 3e-4 rad at 500 Hz, an error of 4e-8.
    delay_s = FAINT / group.sample_rate_hz
    y, later, latest = respond(system, group, starts, [n * delay_s for n in range(3)])
    records, samples, senses = y.shape
    out = np.zeros((records, 2 + 2 * senses, samples, senses))
    out[:, 0] = (up - down) / (2.0 * _STEP)
    # Exactly the derivative by a constant delay, so that the two are seen to be the same.
    out[:, 1] = (4.0 * later - latest - 3.0 * y) / (2.0 * delay_s)
    for k in range(records):
        for s in range(senses):
            out[k, 2 + s, :, s] = y[k, :, s]
            out[k, 2 + senses + s, :, s] = np.linspace(-1.0, 1.0, samples)
    return out


def deviation_columns(
    fit: CampaignFit, records: Sequence[Record], campaign: Campaign, values: Mapping[str, float] | None = None
) -> dict[str, FloatArray]:
    """C (m, N, S) [V per unit of the deviation] of each of ``records``, by name.

    The columns are those at complete parameter ``values``; ``None`` means those of the fit.
    """
    at, respond = fit.values if values is None else values, response_for(fit, campaign)
    known = {record.name: record.start for record in fit.records}
    out: dict[str, FloatArray] = {}
    for places, group in drive_groups_of(records, campaign.instrument, campaign.angular_gain):
        starts = [known.get(records[i].name) for i in places]
        found = _deviation_columns(fit.model, at, group, campaign.instrument, starts, respond)
        out |= {records[i].name: c for i, c in zip(places, found)}
    return out
