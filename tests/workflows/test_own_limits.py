"""Own limits judge a device in compare, diagnose and refine; the shipped ones only gyros of the kind that they are for."""

from dataclasses import replace
from hashlib import sha256
from types import SimpleNamespace

import pytest

from pipeline.device.model import DEFAULT_COMPARE_MODEL
from pipeline.experiment.campaign import write_campaign
from reports.limits import DEFAULT_LIMITS, load_limits
from tests.pipeline.experiment.checks.planted_faults import healthy
from workflows.cli import call
from workflows.learning import ComparisonResult, compare
from workflows.shipped import shipped_limits, shipped_limits_of


@pytest.fixture(scope="module")
def campaign():
    return healthy()


def test_the_shipped_limits_are_for_gyros_in_the_band_of_the_shipped_run(campaign):
    assert shipped_limits_of(campaign) is DEFAULT_LIMITS
    faster = replace(
        campaign,
        records=tuple(replace(r, sample_rate_hz=15.0 * r.sample_rate_hz, clock=None) for r in campaign.records),
    )
    assert shipped_limits_of(faster) is None
    fit = SimpleNamespace(values={"f1_hz": 535.0, "f2_hz": 537.0})
    assert shipped_limits(fit) is DEFAULT_LIMITS
    assert shipped_limits(SimpleNamespace(values={"f1_hz": 8000.0, "f2_hz": 8002.0})) is None


def test_compare_judges_with_the_limits_of_the_user(campaign, tmp_path, capfd):
    wide = load_limits({"limits": {"f1_hz": {"min": 1.0, "max": 1e4}}})
    narrow = load_limits({"limits": {"f1_hz": {"min": 1.0, "max": 2.0}}})
    found = compare(campaign, DEFAULT_COMPARE_MODEL, wide)
    assert found.answer.device_verdict == "pass"
    again = ComparisonResult(found.answers, limits=narrow).answer
    assert (again.device_verdict, again.device_verdict_reason) == ("fail", "f1_hz")
    assert "device: fail by the given limits (lower rocking frequency)" in str(
        ComparisonResult(found.answers, limits=narrow)
    )
    assert not ComparisonResult(found.answers).answer.device_verdict
    write_campaign(campaign, tmp_path)
    own = tmp_path / "own.toml"
    own.write_text("[limits.f1_hz]\nmin = 1.0\nmax = 1e4\n")
    assert call(["compare", str(tmp_path), "--limits", str(own), "--out", str(tmp_path / "page")]) == 0
    page = (tmp_path / "page" / "compare.html").read_text(encoding="utf-8")
    assert f"The limits are those of --limits {own} (sha256 {sha256(own.read_bytes()).hexdigest()[:12]})." in page
    assert call(["compare", str(tmp_path), "--out", str(own)]) == 2
    assert f"the page cannot be written: file exists: '{own / 'compare.html'}'" in capfd.readouterr().err
    assert call(["refine", str(tmp_path), "--limits", "missing.toml"]) == 2
    assert "limits file cannot be read" in capfd.readouterr().err
