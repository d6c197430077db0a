"""A free decay that was logged together with its drive voltage, which is zero throughout."""

from __future__ import annotations

import numpy as np
import pytest

from workflows.cli import main

CAMPAIGN = """
[instrument]
sample_rate_hz = 2000
hold = "zoh"
bias_v = 0.0

[columns]
drive1_V = "v"
sense1_V = "y"

[[record]]
file = "decay.csv"
role = "fit"
at_rest = false
"""


def test_a_drive_column_of_zeros_is_no_reason_to_stop(tmp_path, capsys):
    t = np.arange(4000) / 2000.0
    y = np.exp(-2.0 * t) * np.cos(2.0 * np.pi * 120.0 * t) + 1e-3 * np.random.default_rng(0).normal(size=t.size)
    lines = ["v,y", *(f"0,{value:.9f}" for value in y)]
    (tmp_path / "decay.csv").write_text("\n".join(lines))
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    (tmp_path / "model.toml").write_text('plant = { kind = "modal", modes = 1, sense = "displacement" }\n')
    with pytest.raises(SystemExit) as stop:
        main(["diagnose", str(tmp_path), "--model", str(tmp_path / "model.toml")])
    said = capsys.readouterr()
    assert stop.value.code == 0, said.err
    # Without a drive no effect of the drive shows.
    assert "these data cannot show" in said.out
    assert "loop_delay" in said.out.split("these data cannot show")[1]
