"""The code of docs/notebook.md runs as printed; the results are frozen, print, and give tables."""

import json
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pandas as pd
import pytest

from pipeline.experiment.campaign import write_campaign
from workflows.simulate import campaign_config, simulate

PAGE = Path(__file__).parents[2] / "docs" / "notebook.md"


@pytest.fixture(scope="module")
def notebook(tmp_path_factory, brief_records_of_module):
    """Variables of the page's code after it ran in a folder that holds a campaign."""
    folder = tmp_path_factory.mktemp("notebook")
    # A device within the shipped limits, and an effect that is highly significant.
    device = {"f1_hz": 534.5, "split_hz": 1.9, "theta_deg": -33.0, "zeta1": 3.2e-4, "zeta2": 1.6e-4}
    write_campaign(simulate(campaign_config(None), device, ["sense_nonlinearity"], 5).campaign, folder / "campaign")
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]
    names: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(code, names)
    return names


def test_the_notebook_page_has_at_most_50_lines():
    assert len(PAGE.read_text(encoding="utf-8").splitlines()) <= 50


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
    assert parameters.loc["sense_nonlinearity.1/g", "sd"] > 0.0
    assert isinstance(notebook["how_good"].records, pd.DataFrame)


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
    ("how_good", "harmonic of the drive"), ("missing", "sense_nonlinearity"), ("better", "confirmed"),
])  # fmt: skip
def test_results_print_text_show_tables_and_are_frozen(notebook, name, says):
    answer = notebook[name]
    assert says in str(answer)
    assert repr(answer) == str(answer)
    assert "<table" in answer._repr_html_()
    assert json.loads(json.dumps(answer.to_dict()))
    with pytest.raises(FrozenInstanceError):
        answer.answers = None
