"""Results of the hidden-effects study: answers are assessed, counted and resumed correctly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import UsageError
from pipeline.experiment.noise.level import repeats_of
from workflows.commands.hidden import lines
from workflows.studies.coverage import Share
from workflows.studies.hidden import study
from workflows.studies.hidden.confusion import answer, confusion, figures, main_parameter, power
from workflows.studies.hidden.draw import hide
from workflows.studies.hidden.kinds import KINDS


def _row(kind: str, number: int, hidden: list[str], **found: Any) -> dict[str, Any]:
    step = {"verdict": "adequate", "effects": [], "classes": [], "seconds": 3.0, "cpu_seconds": 2.0, **found}
    ladder = [{"status": None, "error_validate": 2.0}, {"status": "confirmed", "error_validate": 1.0}]
    refined = kind in ("one", "two", "outside", "left-out")
    selection = {
        **step,
        "ladder": ladder if step["effects"] else ladder[:1],
        "theta_deg": [10.0, 0.1],
        "theta_before_deg": [11.0, 0.1],
        "split_hz": [2.0, 0.1],
        "parameters": {"cubic_stiffness.k3": [1.1, 0.1]},
        "snr_left": 1.0,
        "verdict": "adequate" if step["verdict"] == "effect" else step["verdict"],
    }
    return {
        "kind": kind,
        "number": number,
        "seed": 1,
        "hidden": hidden,
        "left_out": hidden if kind == "left-out" else [],
        "snr": [9.0] * len(hidden),
        "sizes": {"cubic_stiffness.k3": 1.0},
        "truth": {"theta_deg": 10.05, "split_hz": 2.5},
        "diagnose": step,
        "refine": selection if refined else None,
        "failed": "",
    }


def test_an_answer_is_assessed_with_its_classes() -> None:
    k, d = "cubic_stiffness", "drive_nonlinearity"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[k]), "diagnose") == "right"
    assert answer(_row("one", 0, [k], verdict="class", effects=[d], classes=[[d, k]]), "diagnose") == "right"
    large = [[d, k, "gain_drift", "loop_delay"]]
    assert answer(_row("one", 0, [k], verdict="class", effects=[d], classes=large), "diagnose") == "partly"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[d]), "diagnose") == "wrong"
    assert answer(_row("one", 0, [k], verdict="effect", effects=[k, d]), "diagnose") == "wrong"
    assert answer(_row("two", 0, [k, d], verdict="effect", effects=[k]), "refine") == "partly"
    assert answer(_row("two", 0, [k, d], verdict="effect", effects=[k, d]), "refine") == "right"
    assert answer(_row("one", 0, [k], verdict="unknown", effects=[d]), "refine") == "unknown"
    assert answer(_row("weak", 0, [k]), "diagnose") == "adequate"
    assert answer(_row("one", 0, [d], invisible=[d]), "refine") == "right"
    assert answer(_row("one", 0, [k], invisible=[d]), "refine") == "adequate"


def test_figures_equal_the_proportions_counted_by_hand() -> None:
    k, d = "cubic_stiffness", "drive_nonlinearity"
    rows = [
        _row("none", 0, []),
        _row("none", 1, [], verdict="effect", effects=[d]),
        _row("one", 0, [k], verdict="effect", effects=[k]),
        _row("one", 1, [k], verdict="effect", effects=[d]),
        _row("left-out", 0, ["loop_delay"], verdict="effect", effects=["pickoff_pole"]),
        _row("left-out", 1, ["loop_delay"], verdict="unknown"),
        replace_failed(_row("weak", 0, [k])),
    ]
    found = figures(rows)
    assert found["campaigns that failed to run"] == 1
    assert found["none: a name (at most 1 %)"] == Share(1, 2)
    assert found["one: right, diagnose (at least 95 %)"] == Share(1, 2)
    assert found["one: wrong name, refine (at most 1 %)"] == Share(1, 2)
    assert found["left-out: unknown, no confirmed rung (at least 90 %)"] == Share(1, 1)
    # A look-alike that leaves a detectable misfit of the true records is not excused.
    rows[4]["refine"]["snr_left"] = 9.0
    assert figures(rows)["left-out: unknown, no confirmed rung (at least 90 %)"] == Share(1, 2)
    assert found["left-out: a look-alike stands for it, excused"] == 1
    assert found["after adding: theta_deg inside its 90 % interval (85 to 95 %)"] == Share(1, 1)
    assert found["after adding: split_hz inside its 90 % interval (85 to 95 %)"] == Share(0, 1)
    assert found["before adding: theta_deg off by more than 3 sd"] == Share(1, 1)
    assert found["size: inside its 95 % interval (91 to 98 %)"] == Share(1, 1)
    assert main_parameter(rows[3]) is None
    assert confusion(rows, "diagnose")["one: cubic_stiffness"] == {k: 1, d: 1}
    assert sum(sum(counts.values()) for _, _, counts in power(rows)) == 2
    text = "\n".join(lines(rows))
    assert "none 1 seed 1  nothing" in text
    assert "one 0 seed 1" not in text


def replace_failed(row: dict[str, Any]) -> dict[str, Any]:
    return {**row, "failed": "ValueError: no", "diagnose": None, "refine": None}


def test_an_interrupted_study_is_resumed(tmp_path: Path) -> None:
    study.append(tmp_path, _row("none", 0, []))
    with (tmp_path / "none.jsonl").open("a") as file:
        file.write('{"kind": "none", "numb')  # power failed here
    study.append(tmp_path, _row("none", 2, []))
    study.append(tmp_path, {**_row("none", 3, []), "seed": 99})
    assert [row["number"] for row in study.rows_in(tmp_path, ("none", "one"), 1)] == [0, 2]
    plan = study.StudyPlan(1, {"none": (0, 2)})
    assert list(study.run_study(plan, tmp_path, 1)) == [(2, 2)]
    assert len((tmp_path / "none.jsonl").read_text().splitlines()) == 4


def test_the_plan_of_the_whole_study_has_the_numbers_of_the_kinds() -> None:
    sizes = {kind: len(numbers) for kind, numbers in study.study_plan("all", None, 0).numbers.items()}
    assert sizes == {kind: found.campaigns for kind, found in KINDS.items()}
    assert sizes["outside"] + sizes["left-out"] == 120
    assert study.study_plan("one", None, 0, only=7).numbers == {"one": (7,)}
    with pytest.raises(UsageError):
        study.study_plan("all", None, 0, only=7)


def test_a_lone_campaign_counts_a_large_class_only_where_every_member_fits_as_well() -> None:
    large = [["cubic_stiffness", "a", "b", "c"]]
    found = {"verdict": "class", "effects": ["a"], "classes": large}
    rows = []
    for number, rise in enumerate([8.9, 9.1]):
        row = _row("lone-one", number, ["cubic_stiffness"], **found)
        row["refine"] = {**row["diagnose"], "ladder": [{"status": None}], "class_delta_chi2": [rise]}
        rows.append({**row, "snr": [31.0]})
    wrong = _row("lone-one", 2, ["cubic_stiffness"], verdict="effect", effects=["gain_drift"])
    missed = _row("lone-one", 3, ["cubic_stiffness"])
    rows += [{**row, "refine": {**row["diagnose"], "ladder": []}, "snr": [31.0]} for row in (wrong, missed)]
    found = figures(rows)
    assert found["lone-one: right, or an honest class (at least 90 %)"] == Share(1, 4)
    assert found["lone-one: a single wrong name (at most 3 %)"] == Share(1, 4)
    assert found["lone-one: adequate, SNR above 30 (at most 2 %)"] == Share(1, 4)


def test_a_lone_campaign_has_two_chirps_and_nothing_that_measures_its_noise() -> None:
    campaign = hide("lone-none", 0, 1).campaign
    assert [record.role for record in campaign.records] == ["fit", "fit"]
    assert not repeats_of(campaign)
    assert set(study.study_plan("lone", 2, 1).numbers) == {"lone-none", "lone-one", "lone-foreign"}
