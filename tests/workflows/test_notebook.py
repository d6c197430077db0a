"""tutorials/notebook.ipynb runs as printed, with the public interface alone; its answers are frozen and printable."""

import ast
import json
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

DOCS = Path(__file__).parents[2] / "docs" / "tutorials"


def code_cells() -> list[str]:
    book = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))
    sources = ["".join(cell["source"]) for cell in book["cells"] if cell["cell_type"] == "code"]
    # A line that begins with % is for the notebook: it shows figures below their cells.
    return ["\n".join(line for line in source.splitlines() if not line.startswith("%")) for source in sources]


@pytest.fixture(scope="module")
def notebook(tmp_path_factory, brief_records_of_module):
    """Variables of the notebook after all its cells ran, one after the other, in an empty folder."""
    names: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("notebook"))
        for k, cell in enumerate(code_cells()):
            exec(compile(cell, f"cell {k}", "exec"), names)
        names["folder"] = Path.cwd()
        # Tables of a run are read when they are asked for.
        names |= {"devices": names["night"].devices, "draws_table": names["night"].posterior}
        yield names


def test_the_notebook_imports_nothing_but_the_interface_and_holds_no_output():
    imported = [
        node
        for cell in code_cells()
        for node in ast.walk(ast.parse(cell))
        if isinstance(node, ast.ImportFrom | ast.Import)
    ]
    assert [ast.unparse(node) for node in imported] == ["from workflows import api as gs"]
    book = json.loads((DOCS / "notebook.ipynb").read_text(encoding="utf-8"))
    assert book["nbformat"] == 4
    assert len({cell["id"] for cell in book["cells"]}) == len(book["cells"])
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book["cells"])


def test_the_page_beside_it_is_short_and_its_code_runs(notebook, monkeypatch, capsys):
    page = (DOCS / "notebook.md").read_text(encoding="utf-8")
    assert len(page.splitlines()) <= 60
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    monkeypatch.chdir(notebook["folder"])
    exec(compile(code, "notebook.md", "exec"), {})
    assert "confirmed" in capsys.readouterr().out
    for name in re.findall(r"^\| `(\w+)`", page, re.M):
        assert name in notebook["gs"].__all__ or name in ("frequency", "time"), name


def test_the_tables_name_the_hidden_effect_and_show_the_error_falling_to_the_noise(notebook):
    where, ladder = notebook["how_good"].where, notebook["better"].table
    assert where.iloc[0]["kind"] == "harmonic"
    assert where.iloc[0]["harmonic"] == 2
    by_family = where.groupby("family")["share"].sum()
    assert set(by_family.index) >= {"frequency", "time", "level", "record"}
    assert (by_family <= 1.0 + 1e-9).all()
    assert notebook["missing"].candidates.index[0] == "sense_nonlinearity"
    assert ladder["effect"].tolist() == ["", "sense_nonlinearity"]
    assert ladder["error_fit"].iloc[0] > 1.1 > 1.02 > ladder["error_fit"].iloc[-1]
    assert ladder["theta_deg_sd"].gt(0.0).all()
    assert ladder["split_hz"].iloc[-1] == pytest.approx(1.9, abs=1e-4)
    parameters = notebook["better"].parameters
    assert parameters.loc["f1_hz", "unit"] == "Hz"
    assert isinstance(notebook["how_good"].records, pd.DataFrame)


def test_the_size_is_that_of_the_truth_within_its_uncertainty(notebook):
    estimate = notebook["better"].parameters.loc["sense_nonlinearity.1/g"]
    assert abs(estimate["value"] - notebook["truth"]) < 5.0 * estimate["sd"] < 0.05 * abs(notebook["truth"])


@pytest.mark.parametrize("table", ["where", "records", "parameters"])
def test_tables_hold_numbers_not_lists_or_texts(notebook, table):
    for answer in (notebook["how_good"], notebook["better"]):
        if hasattr(answer, table):
            _only_numbers_and_texts(getattr(answer, table))
    _only_numbers_and_texts(notebook["missing"].candidates)
    sizes = notebook["missing"].sizes
    assert sizes[["value", "sd"]].dtypes.eq(np.float64).all()
    assert sizes["unit"].ne("").any()


def _only_numbers_and_texts(table: pd.DataFrame) -> None:
    assert len(table)
    for name, column in table.items():
        kinds = {type(value) for value in column.dropna()}
        numeric = pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column)
        assert numeric or kinds <= {str}, (name, kinds)


def test_the_verdict_is_undecided_until_the_model_explains_the_records(notebook):
    ladder = notebook["better"].table
    assert ladder["verdict"].iloc[0] == "undecided"
    assert ladder["verdict"].iloc[-1] == ladder["verdict_at_face"].iloc[-1] != "undecided"


def test_regions_state_the_error_of_the_last_model_and_the_explained_share(notebook):
    regions = notebook["better"].where
    first = regions.iloc[0]
    assert first["error"] > 1.5
    assert first["error_after"] == pytest.approx(1.0, abs=0.1)
    assert first["explained"] > 0.9


@pytest.mark.parametrize(("name", "says"), [
    ("how_good", "harmonic of the drive"), ("missing", "sense_nonlinearity"), ("better", "confirmed"), ("found", "misfit"),
    ("night", "20 devices, yield"),
])  # fmt: skip
def test_results_print_text_show_tables_and_are_frozen(notebook, name, says):
    answer = notebook[name]
    assert says in str(answer)
    assert repr(answer) == str(answer)
    assert "<table" in answer._repr_html_()
    if hasattr(answer, "to_dict"):
        assert json.loads(json.dumps(answer.to_dict()))
    with pytest.raises(FrozenInstanceError):
        answer.results = None


def test_identification_gives_quantities_draws_and_their_status(notebook):
    found = notebook["found"]
    assert found.status == "misfit"
    split = found.quantities.loc["split_hz"]
    assert split["q05"] < split["value"] < split["q95"]
    assert split["unit"] == "Hz"
    assert found.posterior["split_hz"].std() == pytest.approx(split["sd"], rel=0.05)


def test_the_night_gives_yields_devices_draws_and_figures(notebook):
    gs, night, devices = notebook["gs"], notebook["night"], notebook["devices"]
    total = night.yields.iloc[0]
    assert total["devices"] == len(devices) == 20
    assert total["low"] < total["yield"] < total["high"]
    assert total["yield"] == devices["verdict"].eq("pass").mean()
    by_lot = night.yields.loc[[(lot, "") for lot in devices["lot"].unique()]]
    assert by_lot["devices"].sum() == 20
    assert devices["split_hz"].dtype == np.float64
    assert night.columns.loc[("devices", "split_hz"), "unit"] == "Hz"
    assert night.devices_table.schema.field("split_hz").metadata[b"unit"] == b"Hz"
    first, draws = notebook["first"], notebook["draws_table"]
    assert draws.loc[first, "theta_deg"].std() == pytest.approx(devices.loc[first, "theta_deg_sd"], rel=0.5)
    asked = notebook["night"].query("SELECT count(*) AS n FROM devices WHERE verdict = 'pass'")
    assert asked["n"].item() == devices["verdict"].eq("pass").sum()
    assert {"wafer-maps", "pareto", "theta-split", "coverage"} <= set(gs.figures.all_of(night))


def test_figures_are_plain_figures_without_pyplot_state(notebook, tmp_path):
    import matplotlib.pyplot as plt

    gs = notebook["gs"]
    for figure in (notebook["ladder"], notebook["maps"], gs.figures.corner(notebook["night"], notebook["first"])):
        assert isinstance(figure, Figure)
        assert gs.figures.save(figure, tmp_path / "figure.png", dpi=60).stat().st_size > 3000
    assert plt.get_fignums() == []
    shown = gs.figures.all_of(notebook["better"])
    assert {"ladder", "level", "channel-errors", "resonance-0", "spectrogram-0"} <= set(shown)
    assert isinstance(gs.figures.channels(notebook["campaign"]), Figure)


def test_draws_for_arviz_have_units_and_the_spread_of_the_posterior(notebook):
    gs, draws = notebook["gs"], notebook["draws"]
    posterior, split = draws.posterior, notebook["devices"].loc[notebook["first"]]
    assert posterior.sizes["chain"] == 1
    assert posterior["split_hz"].attrs["unit"] == "Hz"
    assert float(draws.constant_data["true_split_hz"]) == split["true_split_hz"]
    fitted = gs.inference_data(notebook["better"]).posterior
    parameters = notebook["better"].parameters
    for name in ("theta_deg", "f1_hz", "sense_nonlinearity.1/g"):
        # 4000 draws: the sd is known to 1.1 %.
        drawn = fitted[name.replace("/", "_per_")]
        assert float(drawn.std()) == pytest.approx(parameters.loc[name, "sd"], rel=0.06)
        assert drawn.attrs["unit"] == parameters.loc[name, "unit"]
    sampled = gs.inference_data(notebook["found"]).posterior
    assert "identification" in sampled.attrs["draws_from"]
    assert "normal" in fitted.attrs["draws_from"]
