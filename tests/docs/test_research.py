"""tutorials/research.ipynb runs as printed: an effect and an irregularity of the reader's own are hidden and found."""

import json
from pathlib import Path

import pytest

BOOK = Path(__file__).parents[2] / "docs" / "tutorials" / "research.ipynb"


@pytest.fixture(scope="module")
def names(tmp_path_factory, brief_records_of_module):
    """Variables of the notebook after all its cells ran in an empty folder, with short records."""
    book = json.loads(BOOK.read_text(encoding="utf-8"))
    found: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("research"))
        for cell in book["cells"]:
            if cell["cell_type"] == "code":
                lines = [line for line in "".join(cell["source"]).splitlines() if not line.startswith("%")]
                exec(compile("\n".join(lines), cell["id"], "exec"), found)
        yield found


def test_the_own_effect_is_the_only_one_found_with_the_hidden_size(names):
    found = names["found"]
    assert found.verdict == "adequate"
    assert found.table["effect"].tolist() == ["", "drive_softening"]
    assert found.table["status"].iloc[-1] == "confirmed"
    size = found.parameters.loc["drive_softening.k"]
    assert abs(size["value"] - 30.0) < 5.0 * size["sd"] < 3.0


def test_the_own_irregularity_is_found_in_the_lot(names):
    refined = names["refined"]
    assert [name.split(".")[0] for name in refined.irregularities] == ["notch_stress"]
    assert refined.table["status"].iloc[-1] == "confirmed"


def test_the_book_holds_no_output(names):
    book = json.loads(BOOK.read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book["cells"])
