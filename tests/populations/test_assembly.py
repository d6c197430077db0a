"""Springs, post, electrodes and damping agree with dense matrices and with known limits."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.arrays import FloatArray
from populations.assembly import Structure, combine, effects, parameters, softening, stiffness
from populations.irregularities.misorientation import ln_young
from populations.irregularity import Change
from populations.spec import load_spec
from populations.symmetric import Symmetric, as_complex, axis_deg, congruence, inverse_root, product, rotated

DEVICE = load_spec().device
small = st.floats(-0.3, 0.3)


def nominal(count: int = 1, springs: int = 4) -> Structure:
    return combine([], count, springs)


def plant(structure: Structure, device=DEVICE) -> dict[str, float]:  # type: ignore[no-untyped-def]
    return {name: float(value[0]) for name, value in parameters(device, structure, 1.0, 1.0).items()}


def column(*values: float) -> FloatArray:
    return np.array(values)[:, None]


def axis_distance(a: float, b: float) -> float:
    return abs((a - b + 90.0) % 180.0 - 90.0)


def dense(matrix: Symmetric) -> FloatArray:
    a0, a = float(matrix.mean[0]), complex(matrix.anisotropy[0])
    return np.array([[a0 + a.real, a.imag], [a.imag, a0 - a.real]])


def symmetric(mean: float, real: float, imag: float) -> Symmetric:
    return Symmetric(np.array([mean]), as_complex(np.array([real]), np.array([imag])))


@given(small, small, small, small, st.floats(-90.0, 90.0))
def test_symmetric_algebra_equals_dense_matrices(a: float, b: float, c: float, d: float, angle: float) -> None:
    first, second = symmetric(1.0, a, b), symmetric(0.8, c, d)
    x, y = dense(first), dense(second)
    np.testing.assert_allclose(dense(product(first, second)), (x @ y + y @ x) / 2.0, atol=1e-14)
    np.testing.assert_allclose(dense(congruence(first, second)), x @ y @ x, atol=1e-14)
    root = dense(inverse_root(first))
    np.testing.assert_allclose(root @ x @ root, np.eye(2), atol=1e-13)
    q = np.array([[math.cos(math.radians(angle)), math.sin(math.radians(angle))]])
    q = np.vstack([q, [[-q[0, 1], q[0, 0]]]])
    in_new_axes = Symmetric(second.mean, rotated(second.anisotropy, np.array([angle])))
    np.testing.assert_allclose(dense(in_new_axes), q @ y @ q.T, atol=1e-14)
    theta = math.radians(float(axis_deg(second.anisotropy)[0]))
    lower = np.array([math.cos(theta), math.sin(theta)])
    np.testing.assert_allclose(y @ lower, np.linalg.eigvalsh(y)[0] * lower, atol=1e-13)


def test_nominal_device_has_the_nominal_modes_and_no_split() -> None:
    found = plant(nominal())
    assert found["split_hz"] == 0.0
    assert found["f1_hz"] == DEVICE.rocking_hz
    assert found["f3_hz"] == DEVICE.updown_hz
    assert found["zeta1"] == found["zeta2"] == pytest.approx(1.0 / 4400.0, rel=1e-15)
    assert found["zeta3"] == pytest.approx(1.0 / 860.0, rel=1e-15)
    assert found["c12_per_s"] == found["sense_imbalance"] == found["drive_imbalance"] == 0.0


def test_nominal_gains_are_those_of_the_paper_s_modal_matrices() -> None:
    # Singular values of K_S^-1 M_i K_D^-1 (the paper, section 4.2), in coordinates where the mean gain is 1.
    sense, drive = (0.6793 + 0.7338) / 2.0, (0.7066 + 0.7076) / 2.0
    updown = 57.27 * sense * drive
    rocking = (26.6797 + 26.2276) / 2.0 * sense * drive
    assert DEVICE.updown_gain_per_s == pytest.approx(updown, rel=2e-3)
    assert DEVICE.rocking_gain_per_s == pytest.approx(rocking, rel=1e-2)


def test_stiffness_mismatch_of_springs_at_right_angles_gives_theta_0_or_90_deg() -> None:
    stiff_y = plant(replace(nominal(), ln_spring=column(0.0, 0.01, 0.0, 0.0)))
    stiff_x = plant(replace(nominal(), ln_spring=column(0.01, 0.0, 0.0, 0.0)))
    # A stiffer spring on the y axis raises the stiffness of rocking about x.
    assert stiff_y["theta_deg"] == pytest.approx(90.0, abs=1e-9)
    assert stiff_x["theta_deg"] == pytest.approx(0.0, abs=1e-9)
    assert stiff_x["split_hz"] == pytest.approx(535.5 * 0.01 / 4.0, rel=5e-3)


@given(st.lists(st.floats(-0.01, 0.01), min_size=4, max_size=4), st.floats(-80.0, 80.0))
def test_rotating_all_springs_rotates_theta_and_keeps_the_split(ln: list[float], angle: float) -> None:
    azimuths = np.array([0.0, 50.0, 170.0, 260.0])
    before = plant(
        replace(nominal(), ln_spring=column(*ln)), msgspec.structs.replace(DEVICE, spring_azimuth_deg=tuple(azimuths))
    )
    device = msgspec.structs.replace(DEVICE, spring_azimuth_deg=tuple(azimuths + angle))
    after = plant(replace(nominal(), ln_spring=column(*ln)), device)
    assert axis_distance(after["theta_deg"], before["theta_deg"] + angle) < 1e-6
    assert after["split_hz"] == pytest.approx(before["split_hz"], rel=1e-9)
    # An azimuth error common to all springs is the same rotation.
    error = replace(nominal(), ln_spring=column(*ln), azimuth_rad=np.deg2rad(column(*[angle] * 4)))
    moved = plant(error, msgspec.structs.replace(DEVICE, spring_azimuth_deg=tuple(azimuths)))
    assert axis_distance(moved["theta_deg"], after["theta_deg"]) < 1e-6


def test_mode_frequencies_vary_as_thickness_to_the_power_1_5() -> None:
    found = plant(replace(nominal(), ln_spring=column(*[3.0 * math.log(1.02)] * 4)))
    assert found["f1_hz"] / DEVICE.rocking_hz == pytest.approx(1.02**1.5, rel=1e-12)
    assert found["f3_hz"] / DEVICE.updown_hz == pytest.approx(1.02**1.5, rel=1e-12)
    assert found["split_hz"] == pytest.approx(0.0, abs=1e-9)


def test_the_anisotropy_of_the_paper_s_device_gives_its_split_and_theta() -> None:
    e = 1.9 / 535.45 * np.exp(2j * np.deg2rad(-33.0 + 90.0))
    found = plant(replace(nominal(), anisotropy=np.array([e])))
    assert found["split_hz"] == pytest.approx(1.9, rel=2e-3)
    assert found["theta_deg"] == pytest.approx(-33.0, abs=1e-9)


@given(small, small, st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
def test_damping_in_the_stiffness_axes_is_the_rotated_damping_matrix(a: float, b: float, c: float, d: float) -> None:
    structure = replace(
        nominal(), anisotropy=np.array([a / 30 + 1j * b / 30]), damping_anisotropy=np.array([c + 1j * d])
    )
    found = plant(structure)
    theta, rate = math.radians(found["theta_deg"]), 2.0 * math.pi * 535.5 / 2200.0
    q = np.array([[math.cos(theta), math.sin(theta)], [-math.sin(theta), math.cos(theta)]])
    expected = q @ (rate * np.array([[1 + c, d], [d, 1 - c]])) @ q.T
    c11, c22 = (4.0 * math.pi * found[f"f{i}_hz"] * found[f"zeta{i}"] for i in (1, 2))
    np.testing.assert_allclose(
        [c11, c22, found["c12_per_s"]], [expected[0, 0], expected[1, 1], expected[0, 1]], atol=1e-12
    )


def test_damping_anisotropy_is_limited_so_that_damping_stays_positive_semidefinite() -> None:
    found = plant(replace(nominal(), anisotropy=np.array([1e-3 + 2e-3j]), damping_anisotropy=np.array([3.0 - 1.0j])))
    c11, c22 = (4.0 * math.pi * found[f"f{i}_hz"] * found[f"zeta{i}"] for i in (1, 2))
    assert found["c12_per_s"] ** 2 == pytest.approx(c11 * c22, rel=1e-9)


def test_updown_tilt_and_post_inertia_equal_the_dense_three_by_three_problem() -> None:
    rng = np.random.default_rng(4)
    ln, offset = rng.normal(0.0, 2e-4, 4), (0.3e-3, -0.5e-3)  # offset in mm
    structure = replace(nominal(), ln_spring=ln[:, None], post_offset_mm=np.array([complex(*offset)]))
    values = parameters(DEVICE, structure, 1.0, 1.0)

    # Independent: z up, psi_x, psi_y; unit mass and arm; I = 1 / mu; springs on the axes at r = r / l.
    k0 = (2.0 * math.pi * DEVICE.updown_hz) ** 2 / 4.0
    stiff, mass = np.zeros((3, 3)), np.diag([1.0, 1.0 / DEVICE.lever, 1.0 / DEVICE.lever])
    for k, azimuth in zip(k0 * np.exp(ln), np.deg2rad(DEVICE.spring_azimuth_deg)):
        x, y = DEVICE.spring_radius * np.cos(azimuth), DEVICE.spring_radius * np.sin(azimuth)
        lever = np.array([1.0, y, -x])
        stiff += k * np.outer(lever, lever)
    x, y = np.array(offset) / DEVICE.arm_mm
    lever, centre = np.array([1.0, y, -x]), np.array([1.0, 0.0, 0.0])
    mass += DEVICE.post_mass_fraction * (np.outer(lever, lever) - np.outer(centre, centre))
    squared, shapes = np.linalg.eig(np.linalg.solve(mass, stiff))
    order = np.argsort(squared)
    updown = shapes[:, order[2]] / shapes[0, order[2]]
    # Down is positive in the paper: S1 at (-1, 1), S2 at (-1, -1) see -(z' + y psi_x' - x psi_y').
    s1, s2 = (-(updown[0] + y * updown[1] - x * updown[2]) for x, y in ((-1.0, 1.0), (-1.0, -1.0)))
    tilt = (s1 - s2) / (s1 + s2)
    found = effects(DEVICE, structure, 1.0, values)["updown_tilt"]["t_x"][0]
    assert tilt == pytest.approx(found, rel=5e-3)
    assert abs(tilt) > 1e-4
    frequencies = np.sqrt(squared[order]) / (2.0 * math.pi)
    # Coupling to up-down enters the frequencies in second order only.
    np.testing.assert_allclose(frequencies, [values[f"f{i}_hz"][0] for i in (1, 2, 3)], rtol=1e-6)


def test_bias_softens_as_its_square_and_a_gap_as_its_third_power() -> None:
    twice = parameters(DEVICE, nominal(), 2.0, 1.0)
    shift = float(twice["f1_hz"][0]) - DEVICE.rocking_hz
    assert shift == pytest.approx(DEVICE.softening_hz_per_v2 * 3.0 * 25.0, rel=0.01)
    narrow = replace(nominal(), ln_gap=column(-0.01, 0.01, 0.0, 0.0))
    k = stiffness(DEVICE, narrow, 1.0).rocking
    # The softening spring at D1, (1, 1), is larger: K_xy = -sum k x y with k < 0 is positive.
    assert k.anisotropy[0].imag == pytest.approx(0.5 * softening(DEVICE) * (math.exp(0.03) - math.exp(-0.03)), rel=1e-9)
    assert abs(k.anisotropy[0].real) < 1e-15


def test_the_softening_effect_equals_the_frequency_shift_by_the_bias() -> None:
    values = parameters(DEVICE, nominal(), 1.0, 1.0)
    inverse_gap = effects(DEVICE, nominal(), 1.0, values)["electrostatic_softening"]["1/g"][0]
    # M_D M_D^T = 2: both drives lower omega^2 by 2 G_r V_b / g.
    lowered = 2.0 * DEVICE.rocking_gain_per_s * DEVICE.nominal_bias_v * inverse_gap
    shift_hz = lowered / (2.0 * (2.0 * math.pi) ** 2 * DEVICE.rocking_hz)
    assert shift_hz == pytest.approx(-DEVICE.softening_hz_per_v2 * DEVICE.nominal_bias_v**2, rel=1e-12)


def test_electrode_imbalances_and_mismatch_follow_gains_and_arms() -> None:
    structure = replace(nominal(), ln_area=column(0.0, 0.0, 0.0, 0.074), ln_arm=column(0.0, 0.02, 0.0, 0.0))
    values = parameters(DEVICE, structure, 1.0, 1.0)
    other = effects(DEVICE, structure, 1.0, values)["electrode_mismatch"]
    assert values["sense_imbalance"][0] == pytest.approx(math.tanh(0.037), rel=1e-12)
    assert values["drive_imbalance"][0] == 0.0
    assert other["m_S"][0] == pytest.approx(0.0, abs=1e-15)
    assert other["m_D"][0] == pytest.approx(math.tanh(0.01), rel=1e-12)


def test_gas_loss_is_proportional_to_the_pressure_and_adds_to_the_other_losses() -> None:
    loss = [plant(replace(nominal(), ln_pressure=np.array([math.log(p)])))["zeta1"] for p in (1.0, 2.0, 3.0, 1e-12)]
    assert loss[2] - loss[1] == pytest.approx(loss[1] - loss[0], rel=1e-9)
    assert 1.0 / (2.0 * loss[3]) == pytest.approx(1.0 / (1.0 / 9000.0 + 1e-6), rel=1e-9)


def test_silicon_modulus_has_its_published_extremes_and_four_fold_symmetry() -> None:
    angle = np.deg2rad(np.array([0.0, 45.0, 90.0, 135.0, 46.0]))
    young = np.exp(ln_young(angle)) / 1e9
    np.testing.assert_allclose(young[:4], [130.2, 169.0, 130.2, 169.0], rtol=2e-3)
    assert 2e-4 < 1.0 - young[4] / young[1] < 5e-4


def test_change_of_the_wrong_shape_names_the_irregularity() -> None:
    from pipeline.errors import ConfigError

    for wrong in (Change(ln_spring=np.zeros(3)), Change(ln_stiffness=np.array([np.nan] * 3))):
        with pytest.raises(ConfigError, match="irregularity mine"):
            combine([("mine", wrong)], 3, 4)
