"""What an effect declares about itself is true; every effect, in the library or in a user's folder, inherits these tests."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from effect_cases import INSTRUMENT, LIBRARY, RECORD, USERS, is_scanned, values_at
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import PAPER_LIKE as PLANT

from pipeline.arrays import FloatArray
from pipeline.device.effect import Context, Effect, Laws, find_effects, load_effect
from pipeline.device.gyro import PHYSICAL, gyro_mechanics
from pipeline.device.mechanics import modes_of
from pipeline.device.model import DEFAULT_COMPARE_MODEL, SCREENING_MODEL, Model, PlantSpec, mains_effects
from pipeline.errors import ConfigError
from pipeline.experiment.excitation import Multisine, drive_samples
from pipeline.experiment.forward.drive_groups import drive_group_of
from pipeline.experiment.forward.integrate import trajectory
from pipeline.experiment.forward.record import base_of, forward, jacobian, signatures
from pipeline.experiment.forward.system import assemble, conditions_of
from pipeline.experiment.instrument import Instrument
from pipeline.experiment.record import Record
from pipeline.quantities import NAMES

SHAPE = DEFAULT_COMPARE_MODEL.built.shape


def _parameters(effect: Effect) -> FloatArray:
    """One scale of the parameters of a force law, and the place of its own coordinates if it has some."""
    p = np.array([m.null + m.scale for m in effect.members(SHAPE)])
    return np.append(p, 3.0) if effect.has_coordinates else p


def _force(effect: Effect, q: FloatArray, qd: FloatArray, u: FloatArray) -> FloatArray:
    """The acceleration (n,) of a force law at one scale of its parameters, half a second into a record."""
    assert effect.force is not None
    unit = np.diag(1.0 + np.arange(q.size))
    laws = Laws(unit, 1e7 * unit, np.ones((q.size, 2)), np.ones((2, q.size)), 5.0, 5.0, len(SHAPE.axes))
    out = np.zeros(q.size)
    effect.force(0.5, q, qd, u, _parameters(effect), laws, out)
    return out


def _passive(effect: Effect) -> bool:
    """Whether the force is conservative, or vanishes without velocity so that it can only dissipate."""
    if effect.force is None or effect.has_coordinates:
        return False
    at_rest = _force(effect, np.array([1e-4, -2e-4, 3e-4]), np.zeros(3), np.array([1.0, 2.0]))
    return effect.potential is not None or not np.any(at_rest)


PASSIVE = [name for name, effect in find_effects().items() if _passive(effect)]


def test_passive_forces_are_recognised() -> None:
    assert {"nonlinear_damping", "cubic_stiffness", "quadratic_stiffness", "damping_drift"} <= set(PASSIVE)
    assert not {"frequency_drift", "electrostatic_softening"} & set(PASSIVE)


@pytest.mark.parametrize("name", PASSIVE)
@settings(max_examples=15, deadline=None)
@given(angle=st.floats(0.0, 6.28), share=st.floats(0.1, 50.0))
def test_energy_falls_without_drive(name: str, angle: float, share: float) -> None:
    model = DEFAULT_COMPARE_MODEL.with_effect(name)
    found = model.effect(name)
    values = model.complete({**PLANT, **values_at(found, model, share)})
    system = assemble(model, values, INSTRUMENT, conditions_of(RECORD, INSTRUMENT, None))
    start = np.array([3e-4 * np.cos(angle), 3e-4 * np.sin(angle), 1e-4, 0.0, 0.0, 0.0])
    forces = [(e.force, p) for e, p in system.forces]
    linear, deviation = trajectory(system.mechanics, forces, system.laws, np.zeros((300, 2)), 1e-4, "zoh", start)
    q, qd = np.hsplit(linear + deviation, 2)
    potential = 0.5 * np.einsum("mi,ij,mj->m", q, system.mechanics.stiffness[0], q)
    if found.potential is not None:
        potential = potential + found.potential(q, system.forces[0][1], system.axes)
    energy = potential + 0.5 * np.sum(qd**2, axis=1)
    assert np.all(np.diff(energy) < 1e-9 * energy[0])
    assert energy[-1] < energy[0]


@pytest.mark.parametrize("others", [(), ("internal_resonance_1_2",)])
def test_coordinates_that_forces_alone_move_are_integrated_apart_without_a_change(others: tuple[str, ...]) -> None:
    model = DEFAULT_COMPARE_MODEL.with_effect("hysteresis")
    values = {"hysteresis.k": 1e5, "hysteresis.r": 1e-4}
    for name in others:
        model = model.with_effect(name)
        values |= values_at(model.effect(name), model, 0.5)
    system = assemble(
        model, model.complete({**PLANT, **values}), INSTRUMENT, conditions_of(RECORD, INSTRUMENT, None)
    ).integrated
    m, forces = system.mechanics, [(e.force, p) for e, p in system.forces]
    drive = RECORD.drive_v[:600]
    assert m.stiffness.shape[1] == 5 + len(others)
    solve = partial(trajectory, m, forces, system.laws, drive, 1.0 / RECORD.sample_rate_hz, "zoh")
    for start in (
        None,
        np.concatenate([[1e-4, -2e-4, 0.0], np.zeros(2 + len(others)), [0.1, 0.2, -0.3], np.zeros(2 + len(others))]),
    ):
        _, together = solve(start)
        _, apart = solve(start, reads=m.reads[0])
        np.testing.assert_allclose(apart, together @ m.reads[0].T, rtol=0.0, atol=1e-10 * np.max(np.abs(apart)))
    # A memory that is read, or does not start at zero, is integrated with all others.
    read = m.reads[0] + np.eye(1, 2 * m.stiffness.shape[1], m.stiffness.shape[1] + 4)
    _, together = solve(None)
    _, apart = solve(None, reads=read)
    np.testing.assert_allclose(apart, together @ read.T, rtol=0.0, atol=1e-10 * np.max(np.abs(apart)))


def test_a_hysteresis_takes_the_area_of_its_loops() -> None:
    """Bouc and Wen's law with n = 1 dissipates k |h| (|psi' h| + psi' h)/(2 r); k h^2/2 is what it stores."""
    model = DEFAULT_COMPARE_MODEL.with_effect("hysteresis")
    values = model.complete({**PLANT, "hysteresis.k": 1e5, "hysteresis.r": 1e-4})
    system = assemble(model, values, INSTRUMENT, conditions_of(RECORD, INSTRUMENT, None)).integrated
    assert system.mechanics.stiffness.shape[1] == 5
    start = np.zeros(10)
    start[:2] = 3e-4, -2e-4
    forces = [(e.force, p) for e, p in system.forces]
    linear, deviation = trajectory(system.mechanics, forces, system.laws, np.zeros((400, 2)), 1e-4, "zoh", start, 40)
    q, qd = np.hsplit(linear + deviation, 2)
    h, s = qd[:, 3:], qd[:, :2]
    energy = 0.5 * np.einsum("mi,ij,mj->m", q, system.mechanics.stiffness[0], q)
    energy += 0.5 * np.sum(qd[:, :3] ** 2, axis=1) + 0.5 * 1e5 * np.sum(h**2, axis=1)
    lost = 1e5 / 2e-4 * np.sum(np.abs(h) * (np.abs(s * h) + s * h), axis=1)
    lost += np.einsum("mi,ij,mj->m", qd[:, :3], system.mechanics.damping[0][:3, :3], qd[:, :3])
    step = 1e-4 / 40
    assert energy[-1] < 0.9 * energy[0]
    assert energy[0] - energy[-1] == pytest.approx(step * np.sum(0.5 * (lost[1:] + lost[:-1])), rel=1e-4)
    assert np.abs(h).max() == pytest.approx(1e-4, rel=0.05)


def test_the_force_is_the_negative_gradient_of_the_potential(effect: Effect) -> None:
    if effect.potential is None:
        return
    q, step = np.array([1e-4, -2e-4, 3e-4, 4e-4, -5e-4])[: 5 if effect.has_coordinates else 3], 1e-9
    around = q + step * np.concatenate([np.eye(q.size), -np.eye(q.size)])
    values = effect.potential(around, _parameters(effect), len(SHAPE.axes))
    force = _force(effect, q, np.ones(q.size), np.ones(2))
    assert np.any(force)
    gradient = (values[: q.size] - values[q.size :]) / (2.0 * step)
    assert force == pytest.approx(-gradient, rel=1e-6, abs=1e-9 * np.abs(force).max())


def test_the_effect_depends_on_the_bias_if_it_says_so(effect: Effect, larger: Model) -> None:
    if effect.disturbance is not None:
        assert not effect.depends_on_bias
        return
    values = values_at(effect, larger, 1.0)
    if effect.adc is not None:
        values = dict.fromkeys(values, 20.0)

    def change(bias_v: float) -> FloatArray:
        record = replace(RECORD, bias_v=bias_v)
        with_effect = forward(larger, {**PLANT, **values}, record, INSTRUMENT)
        return with_effect - forward(DEFAULT_COMPARE_MODEL, PLANT, record, INSTRUMENT)

    usual, low = change(INSTRUMENT.bias_v), change(0.7 * INSTRUMENT.bias_v)
    moved = np.linalg.norm(low - usual) / np.linalg.norm(usual)
    assert (moved > 0.05) if effect.depends_on_bias else (moved == 0.0)


def _residual(rows: FloatArray, basis: FloatArray) -> FloatArray:
    """``rows`` (M, k) without what the columns of ``basis`` (M, m) explain."""
    q, _ = np.linalg.qr(basis / np.linalg.norm(basis, axis=0))
    return rows - q @ (q.T @ rows)


def test_a_wrong_hold_looks_like_the_effect_if_it_says_so(effect: Effect, user_folder: Path) -> None:
    """On a resonator in a wide band: alone, or after a delay, it explains more than half of what a wrong hold leaves."""
    base = Model(PlantSpec("modal", 1, "displacement"), effect_folders=(str(user_folder),))
    if effect.name not in base.candidates() or is_scanned(effect) or effect.resonance:
        assert not effect.mimics_hold
        return
    rate = 610.35
    instrument = Instrument(sample_rate_hz=rate)
    drive = drive_samples(Multisine(1.0, 280.0, (1.0,), 2.0, 2.0), rate)
    record = Record("multisine", rate, drive, np.zeros_like(drive))
    plant = {"f1_hz": 68.0, "zeta1": 0.05, "gain1_s1d1": 2e5}
    group = drive_group_of([record], instrument, None)

    def columns(name: str) -> list[FloatArray]:
        found = signatures(base_of(base, plant, group, instrument), name)
        return [np.stack([column[0].ravel() for column in one.columns], axis=1) for one in found]

    fitted = np.concatenate([jacobian(base, plant, record, instrument)[:, 0], np.ones((drive.shape[0], 1))], axis=1)
    true = forward(base, plant, record, replace(instrument, hold="foh"))
    wrong = true - forward(base, plant, record, instrument)

    def share(of: FloatArray, own: FloatArray) -> float:
        return 1.0 - float(np.sum(_residual(of, own) ** 2) / np.sum(of**2))

    rest, each = _residual(wrong, fitted), [_residual(own, fitted) for own in columns(effect.name)]
    (delay,) = (_residual(own, fitted) for own in columns("loop_delay"))
    shares = [share(rest, own) for own in each]
    if effect.name != "loop_delay":
        shares += [share(_residual(rest, delay), _residual(own, delay)) for own in each]
    assert effect.mimics_hold == (max(shares) > 0.5)


def test_a_resonance_adds_a_mode_with_its_frequency_and_damping(effect: Effect) -> None:
    if effect.mechanics is None:
        assert effect.resonance is None
        return
    members = effect.members(SHAPE)
    p = np.array([m.grid[0] if m.grid else m.null + m.scale for m in members])
    physical = np.array([[PLANT.get(name, 0.0) for name in PHYSICAL]])
    plant = gyro_mechanics(physical)
    changed = effect.mechanics(plant, p, Context(5.0, 5.0, dict(zip(PHYSICAL, physical.T))))
    added = changed.stiffness.shape[1] - plant.stiffness.shape[1]
    if effect.resonance is None:
        # Coordinates of a force law are neither driven nor sensed.
        assert (added > 0) == effect.has_coordinates
        assert not np.any(changed.drive[:, 3:])
        assert not np.any(changed.reads[:, :, 3 : 3 + added])
    else:
        assert added == 1
    if effect.resonance is not None:
        frequency, damping = (p[[m.name for m in members].index(name)] for name in effect.resonance)
        poles = modes_of(changed).poles[0]
        expected = 2.0 * np.pi * frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
        assert np.min(np.abs(poles - expected)) < 1e-9 * abs(expected)


def test_an_opposite_direction_with_opposite_parameters_is_the_same_effect(effect: Effect, larger: Model) -> None:
    angle = effect.direction(SHAPE)
    if angle is None:
        assert all(parameter.per != "direction" for parameter in effect.parameters)
        return
    values = values_at(effect, larger, 1.0)
    opposite = {n: v if larger.by_name[n].grid else -v for n, v in values.items()}
    opposite[effect.full_name(angle)] += 180.0
    found = forward(larger, {**PLANT, **opposite}, RECORD, INSTRUMENT)
    expected = forward(larger, {**PLANT, **values}, RECORD, INSTRUMENT)
    assert np.allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_a_mains_effect_explains_50_and_60_hz(effect: Effect) -> None:
    assert (effect.name in mains_effects()) == (bool(effect.mains_frequency) and effect.name in LIBRARY)
    if effect.mains_frequency:
        (frequency,) = (m for m in effect.parameters if m.name == effect.mains_frequency)
        assert effect.disturbance is not None
        assert {50.0, 60.0} <= set(frequency.grid)


def test_look_alikes_and_their_examples_exist(effect: Effect) -> None:
    own = {member.name for member in effect.members(SHAPE)}
    for like in effect.look_alikes:
        model = Model(effects=like.effects)
        assert effect.name not in like.effects
        assert like.example
        assert set(like.example) <= own
        assert set(like.start) <= set(model.by_name)


def test_a_parameter_that_is_a_result_quantity_puts_its_effect_into_the_screening_model(effect: Effect) -> None:
    quantities = {parameter.quantity for parameter in effect.parameters} - {""}
    assert quantities <= set(NAMES)
    assert (effect.name in SCREENING_MODEL.effects) == bool(quantities)


def test_declared_sizes_are_positive_and_in_order(effect: Effect) -> None:
    if effect.size is not None:
        largest = effect.size.largest(PLANT) if callable(effect.size.largest) else effect.size.largest
        assert 0.0 < effect.size.typical < largest
    for parameter in effect.parameters:
        if parameter.typical is not None:
            assert parameter.low <= parameter.typical[0] < parameter.typical[1] <= parameter.high


def test_a_condition_is_known_and_fixes_the_only_parameter(effect: Effect) -> None:
    assert effect.condition in ("", "rate")
    assert not effect.condition or len(effect.parameters) == 1


def test_a_file_without_declared_properties_has_none(user_folder: Path) -> None:
    found = load_effect(f"{user_folder}/{USERS}.py")
    assert (found.depends_on_bias, found.mimics_hold, found.look_alikes, found.size) == (False, False, (), None)
    assert (found.resonance, found.mains_frequency, found.potential, found.condition) == (None, "", None, "")


@pytest.mark.parametrize(
    ("declared", "match"),
    [
        ({"resonance": ("f", "zeta")}, "no such parameter"),
        ({"mains_frequency": "f"}, "no such parameter"),
        ({"signature": ""}, "does not declare signature"),
        ({"force": None, "drive": lambda v, p, context: v, "potential": lambda q, p, axes: q[:, 0]}, "without a force"),
    ],
)
def test_a_declaration_that_does_not_fit_the_effect_is_refused(declared: dict[str, object], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        replace(find_effects()["cubic_stiffness"], **{"potential": None, **declared})
