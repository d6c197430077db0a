"""compare, diagnose, refine, simulate and demo for a lot, as commands."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
import pytest

from populations.spec import load_spec
from reports.limits import DEFAULT_FILE
from tests.metal_lot import write_metal_lot
from workflows.cli import call


@pytest.fixture(scope="module")
def lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lot of the shipped population."""
    out = tmp_path_factory.mktemp("lots") / "lot7"
    assert call(["simulate", str(out), "--lot", "--seed", "7"]) == 0
    return out


@pytest.fixture(scope="module")
def without_gap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped population without electrode_gap."""
    spec = load_spec(None)
    tables = {name: values for name, values in spec.irregularity.items() if name != "electrode_gap"}
    path = tmp_path_factory.mktemp("populations") / "no_gap.toml"
    path.write_text(msgspec.structs.replace(spec, irregularity=tables).to_toml(), encoding="utf-8")
    return path


@pytest.fixture
def metal(tmp_path: Path) -> Path:
    """A table of another product: thickness with a bow, sheet resistance."""
    write_metal_lot(tmp_path)
    return tmp_path


def found(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict:
    capsys.readouterr()
    assert call([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def test_a_lot_of_the_population_is_as_predicted(lot, capsys):
    answer = found(capsys, "compare", str(lot))
    assert answer["fit_ok"] is True
    assert answer["as_predicted"] is True
    for error in (answer["error"], answer["refitted"]["error"]):
        assert error["fit"] == pytest.approx(1.0, abs=0.05)
        assert error["validate"] == pytest.approx(1.0, abs=0.12)
    assert 0.005 < answer["mixtures"]["lid_leak"] < 0.08
    assert answer["devices"] + answer["held_devices"] == 400
    assert answer["spreads_p_value"] > 0.01
    assert answer["means_p_value"] > 0.01
    assert call(["compare", str(lot / "lot.toml")]) == 0
    assert "as the population predicts" in capsys.readouterr().out


def test_refine_finds_what_the_file_lacks(lot, without_gap, tmp_path, capsys):
    own = tmp_path / "own.toml"
    own.write_bytes(DEFAULT_FILE.read_bytes())
    options = ["--population", str(without_gap), "--limits", str(own), "--out", str(tmp_path)]
    answer = found(capsys, "refine", str(lot), *options)
    assert answer["irregularities"][0].startswith("electrode_gap")
    file, refitted, added = answer["ladder"][:3]
    assert (file["model"], refitted["model"]) == ("as in the file", "refitted")
    assert added["status"] == "confirmed"
    assert file["log_score_validate"] < refitted["log_score_validate"] < added["log_score_validate"]
    forecast = answer["ladder"][-1]["forecast"]
    assert 0.0 <= forecast["low"] <= forecast["mean"] <= forecast["high"] <= 1.0
    assert forecast["devices"] == 80
    refined = load_spec(tmp_path / "population.toml")
    assert "electrode_gap" in refined.irregularity
    assert answer["population_file"] == str(tmp_path / "population.toml")
    # A run accepts it.
    config = tmp_path / "night.toml"
    config.write_text('[source]\nkind = "population"\npath = "population.toml"\n', encoding="utf-8")
    assert call(["run", str(config), "--dry-run"]) == 0
    page = (tmp_path / "ladder.html").read_text(encoding="utf-8")
    assert "electrode_gap" in page
    assert page.count("<svg") == 4
    assert f"The limits are those of --limits {own} (sha256 " in page
    assert "http" not in page.replace("http-equiv", "")


def test_diagnose_names_it_without_a_refit(lot, without_gap, capsys):
    answer = found(capsys, "diagnose", str(lot), "--population", str(without_gap))
    assert answer["verdict"] in ("effect", "class")
    assert any("electrode_gap" in one["part"] for one in answer["candidates"][:3])
    assert "spring_width.wedge" in answer["invisible"]


def test_a_table_of_another_product(metal, capsys):
    answer = found(capsys, "refine", str(metal), "--out", str(metal))
    assert answer["irregularities"] == ["fixed_bow(thickness)"]
    assert answer["ladder"][-1]["forecast"] is not None
    assert not (metal / "population.toml").exists()
    compared = found(capsys, "compare", str(metal))
    assert compared["quantities"] == ["thickness", "resistance"]
    assert compared["error"] is None


def test_an_irregularity_with_its_size(tmp_path, capsys):
    out = tmp_path / "lot"
    assert call(["simulate", str(out), "--lot", "--irregularity", "sidewall_tilt:edge_deg=1.5"]) == 0
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    assert truth["irregularities"]["sidewall_tilt"]["edge_deg"] == 1.5
    answer = found(capsys, "compare", str(out))
    # The pattern is (1.5 / 0.6)^2 times that of the file.
    pattern = answer["patterns"]["sidewall_tilt.pattern"]
    assert abs(pattern["ratio"] - 6.25) < 4.0 * pattern["sd"]
    assert answer["means_p_value"] < 1e-6
    assert answer["as_predicted"] is False


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ('file = "missing.csv"\ngyro = true\n', 5, "cannot be read"),
        ('file = "metal.csv"\n', 2, "quantities are not given once"),
        ('file = "metal.csv"\ngyro = true\n', 5, "no result quantity"),
        ('file = "metal.csv"\n[quantity.q]\ncolumn = "u"\n', 2, "unknown column"),
        ('file = "metal.csv"\n[quantity.q]\ncolumn = "wafer"\n', 5, "holds no numbers"),
        ('file = "metal.csv"\n[quantity.t]\ntransform = "ln"\n', 2, "transform"),
        ('file = "metal.csv"\n[quantity.t]\n[hold]\nwafers = ["A/W9"]\n', 2, "unknown wafer"),
        ('file = "metal.csv"\n[quantity.t]\n[limits.u]\nmin = 1\n', 2, "unknown quantity"),
        ('file = "metal.csv"\n[quantity.t]\nsd = -1.0\n', 5, "negative"),
        ('file = "metal.csv"\n[quantity.c]\n', 5, "same value for every device"),
        ('file = "nan.csv"\n[quantity.t]\n', 5, "no finite value"),
        ('file = "metal.csv"\n[quantity.t]\nuint = "m"\n', 2, "uint"),
    ],
)
def test_a_wrong_lot_is_one_typed_line(metal, text, code, message, capsys):
    (metal / "lot.toml").write_text(text, encoding="utf-8")
    empty = pa.table({"lot": ["A"] * 5, "wafer": ["W"] * 5, "t": [None] * 5}, schema=pa.schema(
        [("lot", pa.string()), ("wafer", pa.string()), ("t", pa.float64())]
    ))  # fmt: skip
    pa_csv.write_csv(empty, metal / "nan.csv")
    capsys.readouterr()
    assert call(["compare", str(metal)]) == code
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 1
    assert message in error[0]


def test_wrong_arguments_are_one_typed_line(metal, lot, tmp_path, capsys):
    cases = [
        (["compare", str(metal), "--population", "cloverleaf"], 2, "population file describes gyros"),
        (["compare", str(lot), "--model", "m.toml"], 2, "no model file"),
        (["diagnose", str(lot), "--effects", str(tmp_path)], 2, "irregularities instead of effects"),
        (["compare", str(lot), "--population", "missing.toml"], 2, "cannot be read"),
        (["compare", str(tmp_path / "nothing"), "--population", "cloverleaf"], 5, "no such lot"),
        (["simulate", str(tmp_path / "a"), "--lot", "--irregularity", "bend"], 2, "no such irregularity"),
        (["simulate", str(tmp_path / "a"), "--lot", "--irregularity", "sidewall_tilt:edge"], 2, "no assignment"),
        (["simulate", str(tmp_path / "a"), "--lot", "--irregularity", "sidewall_tilt:edge_deg=50"], 2, "out of range"),
        (["benchmark", "hidden-irregularities", "--kind", "many"], 2, "no such kind"),
        (["compare", str(metal), "--out", str(metal / "metal.csv")], 2, "metal.csv/compare.html"),
    ]
    for arguments, code, message in cases:
        capsys.readouterr()
        assert call(arguments) == code, arguments
        error = capsys.readouterr().err.strip().splitlines()
        assert len(error) == 1, error
        assert message in error[0]


def test_places_are_needed_for_a_population(lot, tmp_path, capsys):
    table = pq.read_table(lot / "lot.parquet").drop_columns(["die_x_mm"])
    pq.write_table(table, tmp_path / "lot.parquet")
    assert call(["compare", str(tmp_path / "lot.parquet"), "--population", "cloverleaf"]) == 2
    assert "needs the place of each die" in capsys.readouterr().err


def test_the_study_resumes(tmp_path, capsys, monkeypatch):
    from workflows.studies import lots

    made: list[tuple[str, int]] = []

    def stub(kind: str, seed: int) -> dict:
        made.append((kind, seed))
        return {"kind": kind, "seed": seed, "truth": [], "verdict": "adequate", "named": [], "right": [], "wrong": [],
                "largest_class": 0, "forecast": []}  # fmt: skip

    monkeypatch.setattr(lots, "judged", stub)
    for count in (2, 3):
        arguments = [
            "benchmark",
            "hidden-irregularities",
            "--kind",
            "none",
            "--lots",
            str(count),
            "--out",
            str(tmp_path),
        ]
        assert call([*arguments, "--json"]) == 0
    assert made == [("none", 1), ("none", 2), ("none", 3)]
    shown = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert shown["none: a name"]["count"] == 0
    assert shown["none: a name"]["of"] == 3


def test_a_drawn_lot_of_the_study_is_judged():
    from workflows.studies.hidden_lots import hidden_lot
    from workflows.studies.lots import judged

    assert hidden_lot("none", 3).truth == ()
    row = judged("none", 3)
    assert row["named"] == []
    assert row["verdict"] == "adequate"
    assert len(row["forecast"]) == 2
