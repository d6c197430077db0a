"""compare and refine of a lot with --posterior: JSON, text, page, and wrong numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pytest

from workflows.cli import call


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """One quantity of 8 wafers x 6 dies."""
    g = np.random.default_rng(4)
    wafer = np.repeat(np.arange(8), 6)
    columns = {
        "lot": ["A"] * 48,
        "wafer": [f"W{w}" for w in wafer],
        "t": 100.0 + 2.0 * g.normal(size=8)[wafer] + g.normal(size=48),
    }
    pa_csv.write_csv(pa.table(columns), tmp_path / "film.csv")
    (tmp_path / "lot.toml").write_text(
        'file = "film.csv"\n[quantity.t]\nunit = "nm"\n[hold]\nshare = 0.0\n', encoding="utf-8"
    )
    return tmp_path


def test_the_posterior_stands_beside_the_reml_interval(film, capsys):
    assert call(["compare", str(film), "--posterior", "2", "--json", "--out", str(film / "page")]) == 0
    found = json.loads(capsys.readouterr().out)
    answer = found["posterior"]
    assert answer["converged"] is True
    assert set(answer["spreads"]) == set(found["spreads"]) == {"wafer_spread(t)", "device_spread(t)"}
    for name, one in answer["spreads"].items():
        own = found["spreads"][name]
        assert [one["reml"], one["reml_low"], one["reml_high"]] == [own["ratio"], own["low"], own["high"]]
        assert one["low"] < own["ratio"] < one["high"]
    page = (film / "page" / "compare.html").read_text(encoding="utf-8")
    assert "Posterior of the most influential spreads" in page
    assert "R-hat" in page


@pytest.mark.parametrize("count", ["0", "7"])
def test_a_wrong_number_is_one_line_with_exit_code_2(film, capsys, count):
    assert call(["refine", str(film), "--posterior", count]) == 2
    told = capsys.readouterr().err
    assert "--posterior" in told
    assert "1 to 6" in told
    assert "Traceback" not in told


def test_a_campaign_has_no_posterior_of_spreads(tmp_path, capsys):
    assert call(["compare", str(tmp_path / "record.csv"), "--posterior", "2"]) == 2
    assert "belongs to a lot" in capsys.readouterr().err
