"""Single campaigns of the studies of sweeps and decays, in which the loop once failed."""

from __future__ import annotations

from pipeline.device.model import Model
from pipeline.device.plant import PlantSpec
from reports.words.records import record_sentences
from workflows.learning import refine
from workflows.studies.decays import study_row
from workflows.studies.sweeps import drawn_sweep


def test_a_second_mode_of_a_sweep_is_fitted_with_its_own_width() -> None:
    """It lies 2.3 half widths away, and is narrower than the step of the grid on which it is sought."""
    campaign, truth = drawn_sweep(21, "parasitic_mode", 0)
    found = refine(campaign, Model(PlantSpec(kind="modal"))).answer
    assert found.verdict in ("effect", "adequate")
    assert list(found.effects) == ["parasitic_mode"]
    zeta, sd = found.parameters["zeta1"]
    assert abs(zeta - 0.5 / truth["q"]) < 4.0 * sd
    own, _ = found.parameters["parasitic_mode.zeta"]
    assert 0.15 / truth["q"] < own < 0.4 / truth["q"]


def test_a_class_of_a_free_decay_is_an_answer_without_a_proposed_record() -> None:
    row = study_row(2, ("cubic_stiffness", 9))
    assert row["failed"] == ""
    assert row["outcome"] == "correct"


def test_a_jump_whose_row_belongs_to_no_branch_does_not_hide_the_stiffness() -> None:
    """One row of each pass was caught while the motion left its branch; with it the fit ends 14 sd of noise away."""
    campaign, truth = drawn_sweep(22, "cubic_stiffness", 4)
    found = refine(campaign, Model(PlantSpec(kind="modal"))).answer
    assert list(found.effects) == ["cubic_stiffness"]
    assert found.verdict in ("effect", "adequate")
    assert {one.record for one in found.jumps or ()} == {"sweep", "last passes"}
    assert any("jumps there" in line for line in record_sentences(found))
    f1, sd = found.parameters["f1_hz"]
    assert abs(f1 - truth["f0"]) < 4.0 * sd
