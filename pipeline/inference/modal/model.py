"""Poles and residues of a model, matched to a modal record, and start values for a fit.

    c_m = i R1_m + R0_m / w_m              response of a mode at its resonance (M, S, D) [1/s]
    R_k -> G(p_k) exp(-p_k tau) R_k        residues of the mechanics through the read-out, at the poles of the mechanics
    R1 = 2 Re R,   R0 = -2 Re(conj(p) R)

Poles and residues come from the same assembled system as records, so the law of an effect is defined in its file alone.  A
feedthrough does not contribute to residues.  Modes are matched by frequency; c = 0 for a recorded mode that the model lacks.

Shapes: M recorded modes, S senses, D drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np

from ...arrays import BoolArray, ComplexArray
from ...device.mechanics import Mechanics, modes_of
from ...device.model import Model
from ...device.plant import ModalPlant
from ...errors import MeasurementError
from ...experiment.antialias import filter_response
from ...experiment.files.modal_record import ModalRecord
from ...experiment.forward.system import Conditions, System, assemble
from ...experiment.instrument import Instrument
from ...identification.failure import IdentificationError
from ...identification.route import RouteResult, identify_modal

#: Relative distance below which two poles are equal.
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class ResonantModes:
    """poles (M,) [rad/s], Im > 0, and c (M, S, D) [1/s]; ``present`` (M,) is false where a model lacks the mode."""

    poles: ComplexArray
    c: ComplexArray
    present: BoolArray


def at_resonance(poles: ComplexArray, residues: ComplexArray) -> ComplexArray:
    """c = i R1 + R0 / |p| (M, S, D) [1/s] of modes R / (s - p) + conj; poles (M,) [rad/s], residues (M, S, D) [1/s]."""
    r0 = -2.0 * np.real(residues * np.conj(poles)[:, None, None]) / np.abs(poles)[:, None, None]
    return np.asarray(2.0j * residues.real + r0)


def measured_modes(record: ModalRecord) -> ResonantModes:
    """The modes that the record states."""
    omega = 2.0 * np.pi * record.frequency_hz
    poles = np.asarray(omega * (-record.zeta + 1.0j * np.sqrt(1.0 - record.zeta**2)))
    c = np.asarray(1.0j * record.R1 + record.R0 / omega[:, None, None])
    return ResonantModes(poles, c, np.ones(omega.size, dtype=bool))


def conditions(record: ModalRecord) -> Conditions:
    """Operating conditions of the record; without the angular gain, a rate other than zero is unknown."""
    bias = Instrument().bias_v
    known = record.rate_dps is not None and (record.rate_dps == 0.0 or record.angular_gain is not None)
    rate = float(np.deg2rad(record.rate_dps or 0.0)) * (record.angular_gain or 0.0)
    return Conditions(bias, bias, rate if known else None)


def linear_modes(system: System) -> tuple[ComplexArray, ComplexArray]:
    """Poles (n,) [rad/s] of the mechanics, and residues (n, S, D) [1/s] after the read-out; equal poles are merged."""
    poles, residues = _linear_modes([system])
    return _merged(poles[0], residues[0])


def _linear_modes(systems: Sequence[System]) -> tuple[ComplexArray, ComplexArray]:
    """Poles (B, n) [rad/s] and residues (B, n, S, D) [1/s] after the read-out, of systems of one shape."""
    mechanics, readouts = [system.mechanics for system in systems], [system.readout for system in systems]
    modes = modes_of(Mechanics(*(np.concatenate([getattr(m, f.name) for m in mechanics]) for f in fields(Mechanics))))
    p = modes.poles
    q, residues = np.stack([r.poles for r in readouts]), np.stack([r.residues for r in readouts])
    response = np.einsum("bkj,bjst->bkst", 1.0 / (p[:, :, None] - q[:, None, :]), residues)
    response += np.stack([r.static for r in readouts])[:, None]
    response *= np.stack([r.lag(own) for r, own in zip(readouts, p)])[..., None]
    driven = np.stack([r.drive_lag(own) for r, own in zip(readouts, p)])
    return p, np.asarray(response @ modes.residues * driven[:, :, None, :])


def _merged(poles: ComplexArray, residues: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Poles (n,) and residues (n, S, D) with the residues of equal poles added."""
    same = np.abs(poles[:, None] - poles[None, :]) < _SAME * np.abs(poles)
    if np.count_nonzero(same) == poles.size:
        return poles, residues
    first = np.argmax(same, axis=1)
    kept = np.unique(first)
    return poles[kept], np.stack([residues[first == k].sum(axis=0) for k in kept])


def systems_of(model: Model, points: Sequence[Mapping[str, float]], record: ModalRecord) -> list[System]:
    """The system of ``model`` at each of the complete ``points``, behind the filter of the record.

    Raises
    ------
    ConfigError : parameters that no device can have, at any of the points.
    """
    instrument, declared = Instrument(antialias=record.antialias), conditions(record)
    return [assemble(model, values, instrument, declared) for values in points]


def modelled_modes(
    model: Model, points: Sequence[Mapping[str, float]], record: ModalRecord, poles: ComplexArray
) -> tuple[ResonantModes, ...]:
    """The modes of the systems of ``model``, matched to the recorded ``poles`` (M,) [rad/s]; raises as :func:`systems_of`."""
    systems = systems_of(model, points, record)
    alike: dict[tuple[int, int], list[int]] = {}
    for i, system in enumerate(systems):
        alike.setdefault((system.mechanics.stiffness.shape[1], system.readout.poles.size), []).append(i)
    found: dict[int, ResonantModes] = {}
    for places in alike.values():
        for i, own, residues in zip(places, *_linear_modes([systems[i] for i in places])):
            found[i] = _matched(*_merged(own, residues), poles)
    return tuple(found[i] for i in range(len(systems)))


def _matched(own: ComplexArray, residues: ComplexArray, poles: ComplexArray) -> ResonantModes:
    """The modes ``own`` (n,) [rad/s] with ``residues`` (n, S, D) [1/s], in the places of the recorded ``poles`` (M,) [rad/s]."""
    # Loading scipy.optimize takes a fifth of a second.
    from scipy.optimize import linear_sum_assignment

    recorded, modelled = linear_sum_assignment(np.abs(poles[:, None] - own[None, :]))
    resonant = at_resonance(own, residues)
    c = np.zeros((poles.size, *resonant.shape[1:]), dtype=np.complex128)
    matched, present = poles.copy(), np.zeros(poles.size, dtype=bool)
    c[recorded], matched[recorded], present[recorded] = resonant[modelled], own[modelled], True
    return ResonantModes(matched, c, present)


def starting_values(model: Model, record: ModalRecord) -> dict[str, float]:
    """Start values of the plant parameters: from the paper's route for plant "gyro", from the modes for plant "modal".

    Raises
    ------
    MeasurementError : fewer modes than the plant has, or (gyro) not two rocking modes and one up-down mode.
    """
    if isinstance(model.built, ModalPlant):
        return _modal_start(model.built, record)
    if record.frequency_hz.size < 3:
        raise MeasurementError(
            'plant "gyro" has three modes',
            value=f"{record.name}: {record.frequency_hz.size} modes",
            next_step='use plant = { kind = "modal" }',
        )
    route = gyro_route(record)
    norms = np.linalg.norm(route.M, axis=(1, 2)) / 2.0
    return {
        **{f"f{i + 1}_hz": float(route.f_hz[i]) for i in range(3)},
        **{f"zeta{i + 1}": float(route.zeta[i]) for i in range(3)},
        "theta_deg": route.axes.mean_deg,
        "rocking_gain": float(norms[:2].mean()),
        "updown_gain": float(norms[2]),
        "sense_imbalance": route.gains.sense_imbalance,
        "drive_imbalance": route.gains.drive_imbalance,
    }


def gyro_route(record: ModalRecord) -> RouteResult:
    """The paper's route on the strongest three modes that are two rocking modes and one up-down mode.

    Raises
    ------
    IdentificationError : no three modes of the record are.
    """
    failed: list[IdentificationError] = []
    for three in _strongest_first(record, 3):
        try:
            return identify_modal(_chosen(record, three))
        except IdentificationError as error:
            failed.append(error)
    raise failed[0]


def _strongest_first(record: ModalRecord, count: int) -> list[tuple[int, ...]]:
    """All choices of ``count`` modes, sorted by the sum of their peak heights, highest first."""
    modes = measured_modes(record)
    peak = np.linalg.norm(modes.c, axis=(1, 2)) / -modes.poles.real
    choices = combinations(range(peak.size), count)
    return sorted(choices, key=lambda chosen: -float(np.sum(peak[list(chosen)])))


def _chosen(record: ModalRecord, modes: tuple[int, ...]) -> ModalRecord:
    own = list(modes)
    return replace(
        record, frequency_hz=record.frequency_hz[own], zeta=record.zeta[own], R1=record.R1[own], R0=record.R0[own]
    )


def _modal_start(plant: ModalPlant, record: ModalRecord) -> dict[str, float]:
    """Frequencies, damping ratios and real gains B from c = i (i w)^(m - 1) G B, filter response G, m of the plant."""
    if record.frequency_hz.size < plant.modes:
        raise MeasurementError(
            "the plant has more modes than the record",
            value=f"{record.name}: {record.frequency_hz.size} modes",
            allowed=f"at least {plant.modes}",
            next_step="correct modes in the model file",
        )
    modes = measured_modes(record)
    values: dict[str, float] = {}
    for k, m in enumerate(sorted(_strongest_first(record, plant.modes)[0]), 1):
        omega = abs(modes.poles[m])
        filtered = filter_response(record.antialias, np.array([1.0j * omega]))[0]
        gain = (modes.c[m] / filtered * (1.0j * omega) ** (1 - plant.derivative) * -1.0j).real
        values[f"f{k}_hz"] = float(omega / (2.0 * np.pi))
        values[f"zeta{k}"] = float(-modes.poles[m].real / omega)
        for a in range(gain.shape[0]):
            for b in range(gain.shape[1]):
                values[f"gain{k}_s{a + 1}d{b + 1}"] = float(gain[a, b])
    return values
