"""``gyroscreen export``: every format is read back by a program of its own, and wrong input gives one typed message."""

import re
import sys
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest
from matplotlib.image import imread
from stdf_reader import records

from pipeline.store.run import create_run
from pipeline.store.schema import devices_table
from workflows.cli import call

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "exports.md"
TOML = "[limits.split_hz]\nmax = 3.0\n"


def stored(folder: Path, devices: int, **changes: object) -> Path:
    """Results with a run of two lots with two wafers each."""
    store = create_run(folder / "results", "night", TOML, {"seed": 1, "versions": {"gyroscreen": "0.1.0"}})
    split = np.linspace(0.5, 4.0, devices)
    verdict = ["pass" if one <= 3.0 else "fail" for one in split]
    columns: dict = {
        "device_id": [f"=D{k:02d}" for k in range(devices)],
        "lot": [f"L{k % 2}" for k in range(devices)],
        "wafer": [f"L{k % 2}-W{k // 2 % 2}" for k in range(devices)],
        "die_x_mm": 8.0 * (np.arange(devices) % 5),
        "die_y_mm": 8.0 * (np.arange(devices) // 5),
        "split_hz": split,
        "split_hz_sd": np.where(np.arange(devices) == 0, np.inf, 0.01),
        "p_pass": np.where(split <= 3.0, 0.99, 0.01),
        "verdict": verdict,
        "failed_limits": ["" if one == "pass" else "split_hz" for one in verdict],
        "status": ["ok"] * devices,
    }
    if devices:
        store.commit_block(0, devices_table(columns | changes), None)
    store.finish("complete", {})
    return folder / "results"


@pytest.fixture
def results(tmp_path: Path) -> Path:
    return stored(tmp_path, 20)


def export(results: Path, *more: str) -> int:
    return call(["export", "--results", str(results), *more])


def test_csv_holds_every_column_at_full_precision(results, tmp_path, capsys):
    out = tmp_path / "new" / "night.csv"
    assert export(results, "--out", str(out)) == 0
    assert capsys.readouterr().out.split() == [str(out)]
    found = pd.read_csv(out)
    assert found["device_id"].tolist() == [f"=D{k:02d}" for k in range(20)]
    assert np.array_equal(found["split_hz"], np.linspace(0.5, 4.0, 20))
    assert {"theta_deg", "true_theta_deg"} <= set(found.columns)


def test_excel_has_numbers_units_and_a_header_that_stays(results, tmp_path):
    out = tmp_path / "night.xlsx"
    assert export(results, "--out", str(out)) == 0
    book = openpyxl.load_workbook(out)
    assert book.sheetnames == ["yields", "devices", "limits", "columns"]
    sheet = book["devices"]
    names = [cell.value for cell in sheet[1]]
    assert sheet.freeze_panes == "B3"
    assert "theta_deg" not in names
    split = names.index("split_hz") + 1
    assert sheet.cell(2, split).value == "Hz"
    values = [sheet.cell(row, split).value for row in range(3, 23)]
    assert values == pytest.approx(np.linspace(0.5, 4.0, 20))
    # Text that looks like a formula stays text; Excel has no infinity.
    assert sheet.cell(3, 1).value == "=D00"
    assert sheet.cell(3, 1).data_type != "f"
    assert sheet.cell(3, names.index("split_hz_sd") + 1).value == "inf"
    total = [cell.value for cell in book["yields"][3]]
    assert total[0] == "all"
    assert total[2:6] == [20, 14, 6, 0]
    assert total[6] == pytest.approx(0.7)
    assert [cell.value for cell in book["limits"][3]] == ["split_hz", "Hz", None, 3]
    meanings = {row[0].value: row[2].value for row in book["columns"].iter_rows(min_row=3)}
    assert set(meanings) == set(names)
    assert all(meanings.values())


def test_stdf_has_one_file_per_lot(results, tmp_path, capsys):
    assert export(results, "--out", str(tmp_path / "night.stdf")) == 0
    files = [Path(line) for line in capsys.readouterr().out.split()]
    assert [file.name for file in files] == ["night-L0.stdf", "night-L1.stdf"]
    parts = [values["PART_ID"] for file in files for name, values in records(file.read_bytes()) if name == "PRR"]
    assert sorted(parts) == [f"=D{k:02d}" for k in range(20)]


def test_wafer_maps_as_a_table_and_as_pictures(results, tmp_path):
    assert export(results, "--format", "wafermap-csv", "--out", str(tmp_path / "map.csv")) == 0
    found = pd.read_csv(tmp_path / "map.csv")
    assert found.groupby("lot")["wafer"].nunique().tolist() == [2, 2]
    assert np.array_equal(found["die_x"] * 8.0, found["die_x_mm"])
    assert found["hard_bin"].value_counts().to_dict() == {1: 14, 2: 6}
    assert export(results, "--out", str(tmp_path / "map.png")) == 0
    for lot in ("L0", "L1"):
        picture = imread(tmp_path / f"map-{lot}.png")
        assert picture.shape[1] > 1000
        assert picture[..., :3].std() > 0.01


def test_a_long_text_is_cut_with_a_remark(tmp_path, capsys):
    results = stored(tmp_path, 2, device_id=["a" * 300, "b"], lot=["L0", "L0"])
    assert export(results, "--format", "stdf", "--out", str(tmp_path / "night.stdf")) == 0
    assert "1 text was cut to 255" in capsys.readouterr().err
    assert (tmp_path / "night.stdf").exists()


def test_a_run_that_is_not_complete_is_exported_with_a_remark(tmp_path, capsys):
    store = create_run(tmp_path / "results", "night", TOML, {"seed": 1})
    store.commit_block(0, devices_table({"device_id": ["a", "b"], "split_hz": [1.0, 2.0], "status": ["ok"] * 2}), None)
    assert export(tmp_path / "results", "--out", str(tmp_path / "night.csv")) == 0
    assert "not complete: its 2 stored devices" in capsys.readouterr().err
    assert len(pd.read_csv(tmp_path / "night.csv")) == 2


def test_the_default_name_is_that_of_the_run(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert export(results) == 0
    assert (tmp_path / "night.csv").exists()


@pytest.mark.parametrize("line", re.findall(r"^gyroscreen (export.*?) *#", PAGE.read_text(encoding="utf-8"), re.M))
def test_the_commands_of_the_page_run(results, tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    assert call([*line.replace("RUN", "night").split(), "--results", str(results)]) == 0
    assert [path for path in tmp_path.iterdir() if path != results]


CASES = {
    "unknown format": (["--format", "xls"], ("xls", "wafermap-csv")),
    "unknown suffix": (["--out", "night.doc"], ("night.doc", "--format")),
    "no such run": (["nope"], ("nope", "night")),
    "unwritable": (["--out", "/proc/none/night.csv"], ("/proc/none", "--out")),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_arguments_give_one_message(results, capsys, case):
    arguments, words = CASES[case]
    assert export(results, *arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(word in error for word in (*words, "error:", "next:"))


def test_an_empty_run_and_a_missing_folder_give_one_message(tmp_path, capsys):
    results = stored(tmp_path, 0)
    for chosen in ("csv", "xlsx", "stdf", "wafermap-png", "wafermap-csv"):
        assert export(results, "--format", chosen) == 2
        assert "no devices" in capsys.readouterr().err
    assert export(tmp_path / "none") == 2
    assert "no runs" in capsys.readouterr().err


def test_maps_need_positions(tmp_path, capsys):
    results = stored(tmp_path, 2, die_x_mm=None)
    assert export(results, "--format", "wafermap-png") == 2
    assert "die position" in capsys.readouterr().err


def test_a_damaged_table_is_not_exported(results, capsys):
    table = next(results.glob("run=*/devices-*.parquet"))
    table.write_bytes(table.read_bytes()[:-1])
    assert export(results, "--out", str(results / "night.csv")) == 4
    assert not (results / "night.csv").exists()


def test_excel_without_its_package_names_the_extra(results, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)
    assert export(results, "--out", str(tmp_path / "night.xlsx")) == 2
    assert "gyroscreen[excel]" in capsys.readouterr().err
    assert not (tmp_path / "night.xlsx").exists()
