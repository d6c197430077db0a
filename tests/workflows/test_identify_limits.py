"""identify with the limits of the user: the gate is that of a run with these limits."""

import json

import pytest

from pipeline.experiment.campaign import write_campaign
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows.cli import call


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("healthy")
    write_campaign(healthy(), folder)
    return folder


def _identified(capfd, campaign, tmp_path, width_hz):
    limits = tmp_path / "limits.toml"
    limits.write_text(f"[limits]\nsplit_hz = {{ min = 1.9, max = {1.9 + width_hz!r} }}\n", encoding="utf-8")
    code = call(["identify", str(campaign), "--limits", str(limits), "--json"])
    return code, json.loads(capfd.readouterr().out)


def test_limits_narrower_than_what_an_effect_could_do_refuse_the_device(campaign, tmp_path, capfd):
    code, wide = _identified(capfd, campaign, tmp_path, 1.0)
    assert (code, wide["status"], wide["effects_scored"]) == (0, "ok", True)
    # The gate allows a twentieth of the width.
    code, narrow = _identified(capfd, campaign, tmp_path, 10.0 * wide["split_hz_bias_bound"])
    assert (code, narrow["status"]) == (1, "misfit")
    assert "could bias split_hz" in narrow["status_reason"]
    assert narrow["split_hz"] == wide["split_hz"]
    assert wide["bandwidth_hz_sd"] > 0.0
    # The split is at the lower limit; a misfit has no probability of conformity.
    assert 0.0 < wide["p_pass"] < 1.0
    assert (narrow["p_pass"], narrow["verdict"]) == (None, "undecided")
    assert "[operation] gap_um" in wide["figures_unknown"]["shock_limit_g"]
    assert call(["identify", str(campaign), "--limits", str(tmp_path / "limits.toml")]) == 1
    text = capfd.readouterr().out.splitlines()[-1]
    assert (
        text
        == f"The limits are those of --limits {narrow['limits']['file']} (sha256 {narrow['limits']['sha256'][:12]})."
    )


def test_limits_that_cannot_be_read_are_refused(campaign, capfd):
    assert call(["identify", str(campaign), "--limits", "missing.toml"]) == 2
    assert "limits file cannot be read" in capfd.readouterr().err
