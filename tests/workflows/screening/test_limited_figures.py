"""Limits on performance figures: refused where the figure would be null, judged like any other quantity where it is known."""

import numpy as np
import pytest

from pipeline.errors import ConfigError
from pipeline.inference.estimate import Estimate
from pipeline.inference.screening.result import DeviceResult
from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.judging import judged

LIMITS = """
[run]
devices = 3
[limits.bandwidth_hz]
max = 1e3
[limits.scale_factor_v_per_dps]
min = 1e-5
[limits.arw_electronic_deg_per_rth]
max = {arw}
"""


def test_a_limit_on_a_figure_that_would_be_null_is_an_error_that_names_the_key(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(LIMITS.format(arw=1e3))
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    assert "[operation] drive_amplitude_v" in str(caught.value)


def test_figures_are_judged_by_their_draws(tmp_path):
    file = tmp_path / "run.toml"
    verdicts = []
    for arw in (1e3, 1e-3):
        file.write_text(LIMITS.format(arw=arw) + "[operation]\ndrive_amplitude_v = 1.0\n")
        devices = virtual_block(load_config(file), DeviceBlock(0, 0, 3)).devices
        verdicts.append(devices["verdict"].to_pylist())
        for name in ("bandwidth_hz", "scale_factor_v_per_dps", "arw_electronic_deg_per_rth"):
            found, sd, true = (devices[column].to_numpy() for column in (name, f"{name}_sd", f"true_{name}"))
            assert abs(found - true).max() < 6.0 * sd.max()
        assert devices["shock_limit_g"].null_count == 3
    assert verdicts == [["pass"] * 3, ["fail"] * 3]
    assert devices["failed_limits"].to_pylist() == ["arw_electronic_deg_per_rth"] * 3


def test_devices_are_judged_together_as_each_alone():
    random, limits = np.random.default_rng(3), load_config(None).judged_by()
    results = []
    for draws, status in ((300, "ok"), (600, "ok"), (300, "misfit"), (0, "fit_failed"), (300, "ok"), (0, "lost")):
        # Some draws are outside of each limit.
        own = {}
        for one in limits.limits:
            middle = one.low if one.high == np.inf else one.high if one.low == -np.inf else 0.5 * (one.low + one.high)
            own[one.quantity] = middle + 0.4 * one.width * random.standard_normal(draws)
        results.append(DeviceResult({}, Estimate(status, None, {}, own if draws else {}), None))
    together = judged(results, limits)
    alone = [judged([result], limits) for result in results]
    assert str(together) == str({name: [one[name][0] for one in alone] for name in together})
    assert len({p for p in together["p_pass"] if p == p}) == 3
