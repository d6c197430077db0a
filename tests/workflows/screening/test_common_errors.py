"""Common errors of the tester in a run: configuration, block, table."""

import numpy as np

from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.settings import rate_of

PHASE = "[systematic]\nphase_error_sd_deg = 0.5\n"


def test_the_temperature_coefficient_is_that_of_the_population_unless_the_run_states_one(tmp_path) -> None:
    path = tmp_path / "run.toml"
    for text, expected in (
        ("[systematic]\ntemperature_sd_c = 1.0\n", -28.0),
        ('[systematic]\ntemperature_sd_c = 1.0\n[source.values]\n"temperature.tcf_ppm_per_k" = -60.0\n', -60.0),
        ("[systematic]\ntemperature_sd_c = 1.0\ntcf_ppm_per_c = -31.0\n", -31.0),
    ):
        path.write_text(text)
        assert rate_of(load_config(path), 0.7).systematic.tcf_ppm_per_c == expected


def test_a_block_widens_what_the_phase_moves_and_nothing_else(tmp_path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(PHASE)
    block = DeviceBlock(0, 0, 3)
    exact, common = virtual_block(load_config(None), block), virtual_block(load_config(path), block)
    assert exact.posterior is not None
    assert common.posterior is not None
    before, after = exact.devices.to_pydict(), common.devices.to_pydict()
    for name in ("theta_deg", "split_hz_sd", "f1_hz_q05", "zeta1", "quadrature_rate_dps_sd", "error", "status"):
        assert before[name] == after[name]
    leaked = np.abs(before["quadrature_rate_dps"]) * np.deg2rad(0.5)
    np.testing.assert_allclose(after["rate_bias_dps_sd"], np.hypot(before["rate_bias_dps_sd"], leaked), rtol=0.01)
    assert exact.posterior["p_pass_given_common"].null_count == exact.posterior.num_rows
    given = common.posterior["p_pass_given_common"].to_numpy().reshape(3, 100)
    # 100 values of the errors against thousands: their mean differs by at most 1/100 at each end of a limit.
    np.testing.assert_allclose(given.mean(axis=1), after["p_pass"], atol=0.02)
