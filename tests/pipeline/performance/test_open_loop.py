"""Open-loop figures against a time simulation of both modes with Coriolis coupling, which shares none of their formulas."""

import numpy as np
import pytest

from pipeline.arrays import FloatArray
from pipeline.device.operation.loops import Forced, Loops
from pipeline.device.operation.rebalance import operate
from pipeline.inference.estimate import RateSettings, quantities
from pipeline.performance.operating_point import DeclaredOperation

KAPPA, AMPLITUDE_V, RATE_DPS = 0.7, 0.8, 10.0
#: The rebalance loop is open; psi_y, the driven mode at theta = 90 deg, is held at 1 V.
OPEN = Loops(amplitude_v=1.0, rebalance_hz=0.0, direct_per_s=0.0)


def device(split_hz: float, q: float) -> FloatArray:
    return np.array([[535.0, 535.0 + split_hz, 590.0, 0.5 / q, 0.5 / q, 1e-3, 90.0, 0.0, 13.3, 28.6, 0.0, 0.0]])


def sidebands(split_hz: float, q: float, rate_hz: float) -> np.ndarray:
    """Complex amplitudes of psi_x' at omega0 - nu, omega0, omega0 + nu for a rate RATE cos(nu t) (constant for nu = 0)."""
    f_s, seconds, kept = 20_000.0, 1.0 + 12.0 * q / (np.pi * 535.0), 1.0
    t = np.arange(round(seconds * f_s)) / f_s
    run = operate(
        device(split_hz, q),
        KAPPA,
        RATE_DPS * np.cos(2.0 * np.pi * rate_hz * t),
        Forced(np.array([535.0])),
        OPEN,
        duration_s=seconds,
        waveform_s=kept,
    ).waveforms
    drive, sense = run.velocity[0, :, 1], run.velocity[0, :, 0]
    at = t[-sense.size :]
    offsets = np.array([-rate_hz, 0.0, rate_hz]) if rate_hz else np.zeros(1)
    phase = run.phase[0][:, None] + 2.0 * np.pi * offsets * at[:, None]
    basis = np.concatenate([np.cos(phase), -np.sin(phase)], axis=1)
    found = np.linalg.lstsq(basis, sense, rcond=None)[0]
    amplitude = np.linalg.lstsq(basis, drive, rcond=None)[0][offsets.size // 2]
    return (found[: offsets.size] + 1j * found[offsets.size :]) / amplitude


@pytest.mark.parametrize(("split_hz", "q"), [(5.0, 400.0), (0.6, 300.0), (40.0, 300.0)])
def test_scale_factor_and_bandwidth_are_those_of_the_simulated_modes(split_hz, q):
    rate = RateSettings(KAPPA, operation=DeclaredOperation(drive_amplitude_v=AMPLITUDE_V))
    found = quantities(device(split_hz, q), rate)
    static = sidebands(split_hz, q, 0.0)[0]
    # Both blends have the gain 2, so the ratio of the blends is that of the motions.
    assert found["scale_factor_v_per_dps"][0] == pytest.approx(AMPLITUDE_V * abs(static) / RATE_DPS, rel=2e-3)
    lower, _, upper = sidebands(split_hz, q, float(found["bandwidth_hz"][0]))
    turn = np.conj(static) / abs(static)
    response = abs(upper * turn + np.conj(lower * turn)) / abs(static)
    expected = np.sqrt(2.0) if split_hz > 1.0 else np.sqrt(0.5)
    assert response == pytest.approx(expected, rel=3e-3)


def test_the_dependence_on_the_split_is_the_slope_of_the_scale_factor():
    rate = RateSettings(KAPPA, operation=DeclaredOperation(drive_amplitude_v=AMPLITUDE_V))
    # The damping rate of the free mode stays, so its Q grows with its frequency.
    near = [quantities(device(split, 500.0 * (1.0 + split / 535.0)), rate) for split in (1.999, 2.0, 2.001)]
    factor = [one["scale_factor_v_per_dps"][0] for one in near]
    assert near[1]["scale_factor_split_per_hz"][0] == pytest.approx(np.log(factor[2] / factor[0]) / 0.002, rel=1e-5)


def test_what_is_not_declared_is_unknown():
    found = quantities(device(2.0, 500.0), RateSettings(KAPPA))
    assert np.isnan(found["scale_factor_v_per_dps"]).all()
    assert np.isfinite(found["bandwidth_hz"]).all()
