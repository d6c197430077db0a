"""Lots in Python: the calls give what the commands print, as frozen answers with tables and figures."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from matplotlib.figure import Figure

from pipeline.errors import ConfigError, MeasurementError, UsageError
from populations.spec import PopulationSpec, load_spec
from workflows import api as gs
from workflows.cli import call


@pytest.fixture(scope="module")
def lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual lot; gs.simulate_lot returns what gs.read_lot reads."""
    folder = tmp_path_factory.mktemp("python") / "mylot"
    made = gs.simulate_lot(folder, seed=7)
    assert made.lot.device == gs.read_lot(folder).lot.device
    assert len(made.lot.device) == 400
    return folder


@pytest.fixture(scope="module")
def without_gap() -> PopulationSpec:
    spec = load_spec(None)
    return msgspec.structs.replace(
        spec, irregularity={k: v for k, v in spec.irregularity.items() if k != "electrode_gap"}
    )


def test_compare_is_what_the_command_prints(lot, capsys):
    found = gs.compare_lot(gs.read_lot(lot), "cloverleaf")
    assert call(["compare", str(lot), "--json"]) == 0
    assert found.to_dict() == json.loads(capsys.readouterr().out)
    assert "lot mylot against population cloverleaf" in str(found)
    assert repr(found) == str(found)
    assert "<table" in found._repr_html_()
    assert found.spreads.loc["electrode_gap.die", "low"] < 1.2
    assert set(found.calibration.index) == set(found.lot.quantities)
    assert isinstance(gs.figures.spreads(found), Figure)
    assert set(gs.figures.all_of(found)) == {"spreads", "maps-before"}
    with pytest.raises(UsageError, match="nothing to draw"):
        gs.figures.forecast(found)
    with pytest.raises(AttributeError):
        found.answers = None  # type: ignore[misc]


def test_refine_gives_the_ladder_and_a_population_that_reads_back(lot, without_gap, tmp_path):
    found = gs.refine_lot(lot, without_gap, {"limits": {"split_hz": {"max": 3.0}}})
    assert found.irregularities[0].startswith("electrode_gap")
    table = found.table
    assert list(table.model[:2]) == ["as in the file", "refitted"]
    assert table.yield_low.iloc[-1] <= table.yield_mean.iloc[-1] <= table.yield_high.iloc[-1]
    (tmp_path / "refined.toml").write_text(found.population.to_toml(), encoding="utf-8")
    assert "electrode_gap" in gs.load_population(tmp_path / "refined.toml").irregularity
    assert {"forecast", "spreads", "maps-before", "maps-after"} == set(gs.figures.all_of(found))
    named = gs.diagnose_lot(lot, without_gap)
    assert named.verdict in ("effect", "class")
    assert named.candidates.p_value.iloc[0] < 0.003


def test_errors_are_those_of_the_commands(tmp_path, lot):
    with pytest.raises(MeasurementError, match="no such lot"):
        gs.read_lot(tmp_path / "nothing")
    with pytest.raises(ConfigError):
        gs.load_population(tmp_path / "nothing.toml")
    with pytest.raises(UsageError, match="no such irregularity"):
        gs.simulate_lot(tmp_path / "x", irregularities=["nothing"])
