"""The content of the page states what the answers state: verdict, change of the error, places, parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec import UNSET

from pipeline.device.effect import find_effects
from pipeline.learning.answers import Place, SizeDisagreement
from reports.learning.content import LearningContent, learning_content
from reports.words.campaign import UNCONVERGED, ErrorChange
from reports.words.quantities import unit_of

Build = Callable[..., Any]
HELD_OUT, FITTED = "on the held-out records", "on the fitted records"


def content_of(comparison: Any, diagnosis: Any = None, refinement: Any = None) -> LearningContent:
    return learning_content("A17", comparison, diagnosis, refinement, find_effects())


@pytest.mark.parametrize(
    ("changes", "headline"),
    [
        ({"effects": ("pickoff_pole",)}, "What is missing: pick-off pole."),
        (
            {"verdict": "class", "effects": ("pickoff_pole",), "classes": (("pickoff_pole", "loop_delay"),)},
            "What is missing: pick-off pole or loop delay.",
        ),
        (
            {"verdict": "class", "effects": ("mains_hum", "pickoff_pole"), "classes": (("pickoff_pole", "loop_delay"),)},
            "What is missing: mains hum and pick-off pole (or loop delay).",
        ),
        ({"verdict": "unknown", "effects": ()}, "A misfit remains that no effect in the library explains."),
        ({"verdict": "adequate", "effects": ()}, "Nothing is missing: the model explains these records down to the noise."),
        (
            {"verdict": "fit_failed", "effects": ()},
            "The model could not be fitted, so nothing can be said about missing effects.",
        ),
    ],
)  # fmt: skip
def test_the_headline_of_a_diagnosis_states_its_verdict(
    comparison: Build, diagnosis: Build, changes: dict[str, Any], headline: str
) -> None:
    content = content_of(comparison(), diagnosis(**changes))
    assert content.headline == headline
    assert content.verdict == changes.get("verdict", "effect")


@pytest.mark.parametrize(
    ("changes", "headline"),
    [
        ({}, "What was missing: cubic stiffness."),
        (
            {"effects": ("cubic_stiffness", "mains_hum", "adc_saturation")},
            "What was missing: cubic stiffness, mains hum and ADC saturation.",
        ),
        (
            {"verdict": "unknown", "effects": ()},
            "A misfit remains that no effect in the library explains. Cubic stiffness does not remove it.",
        ),
    ],
)
def test_the_headline_of_a_ladder_states_its_verdict(
    comparison: Build, diagnosis: Build, refinement: Build, changes: dict[str, Any], headline: str
) -> None:
    # The diagnosis of the first model names cubic stiffness; the verdict of the ladder decides.
    assert content_of(comparison(), diagnosis(), refinement(**changes)).headline == headline


def test_a_comparison_alone_has_no_verdict(comparison: Build) -> None:
    content = content_of(comparison(fit_ok=False))
    assert (content.verdict, content.headline) == ("", "How well the model explains these records.")
    assert UNCONVERGED in content.notes


def test_a_failed_fit_is_never_evidence(comparison: Build) -> None:
    content = content_of(comparison(error={}, relative_error={}, where=(), parameters={}, fit_ok=False, why="no start"))
    assert content.verdict == "fit_failed"
    assert content.notes == ("The fit failed: no start.",)
    assert not content.change.known


def test_an_adequate_model_with_unknown_noise_is_not_called_complete(comparison: Build, diagnosis: Build) -> None:
    content = content_of(comparison(error={"fit": None}), diagnosis(verdict="adequate", effects=()))
    assert content.headline.startswith("No effect in the library is significant.")


def test_the_held_out_error_leads_and_the_fitted_error_is_kept(comparison: Build, refinement: Build) -> None:
    content = content_of(comparison(), None, refinement())
    assert content.change == ErrorChange(12.3, 1.0, HELD_OUT, delta_chi2=4.9e5)
    assert content.fitted == ErrorChange(14.0, 1.001, FITTED)
    assert content_of(comparison()).change == ErrorChange(12.3, None, HELD_OUT)


def test_without_held_out_records_the_fitted_error_leads(comparison: Build, rung: Build, refinement: Build) -> None:
    ladder = tuple(rung(effect=effect, error_validate=None) for effect in (None, "mains_hum"))
    content = content_of(comparison(error={"fit": 14.0, "validate": None}), None, refinement(ladder=ladder))
    assert content.change.where == FITTED
    assert content.change.after == 1.001


def test_the_relative_error_leads_where_the_noise_is_not_known(
    comparison: Build, rung: Build, refinement: Build
) -> None:
    unknown = {"error_fit": None, "error_validate": None, "misfit_fit": None, "misfit_validate": None}
    compared = comparison(error={"fit": None, "validate": None}, relative_error={"fit": 0.03})
    ladder = (rung(effect=None, relative_error=0.03, **unknown), rung(relative_error=0.004, **unknown))
    content = content_of(compared, None, refinement(ladder=ladder))
    assert content.change == ErrorChange(0.03, 0.004, FITTED, relative=True, delta_chi2=4.9e5)
    assert not content.noise_known


def test_the_notes_state_class_wrong_form_and_partial_effects(comparison: Build, refinement: Build) -> None:
    partial = refinement(last={"status": "partial"})
    first = "Largest part of the misfit of the first model: resonance, 380 to 420 Hz, chirp, sense 1 (70.0\u00a0%)."
    assert content_of(comparison(), None, partial).notes == (
        first,
        "Partial: cubic stiffness is significant on the fitted records, but the held-out records do not confirm it.",
    )
    wrong = refinement(last={"status": "partial"}, wrong_form={"cubic_stiffness": SizeDisagreement("level", -20.0)})
    assert content_of(comparison(), None, wrong).notes == (
        first,
        "The fitted size of cubic stiffness differs between drive levels: its law may have the wrong form.",
    )
    rivals = refinement(
        classes=(("cubic_stiffness", "electrostatic_softening"),), hints=("Check the DAC hold.",),
        separating_record="none with this instrument (best: a chirp, SNR 0.4)",
    )  # fmt: skip
    assert content_of(comparison(), None, rivals).notes == (
        first,
        "These data cannot distinguish cubic stiffness from electrostatic softening.",
        "No record that this instrument can take would separate them (best: a chirp, SNR 0.4).",
        "Check the DAC hold.",
    )


def test_an_unknown_misfit_names_the_structure_that_remains(comparison: Build, refinement: Build) -> None:
    unknown = refinement(
        last={"status": "partial"}, verdict="unknown", left="repeat: chirp and chirp-again, rows 1 to 9"
    )
    notes = content_of(comparison(), None, unknown).notes
    assert notes[-1] == "Remaining structure: a repeatable residual (chirp and chirp-again, rows 1 to 9)."


def test_places_are_sorted_by_share_and_folded_by_record(comparison: Build, refinement: Build) -> None:
    kinds = (
        Place("resonance", None, None, (380.0, 420.0), 0.9, 20.0, family="frequency", error_after=1.0, explained=0.98),
    )
    regions = (
        Place("resonance", "a", "sense1", (380.0, 420.0), 0.2, 9.0, family="frequency"),
        Place("resonance", "b", "sense1", (380.0, 420.0), 0.7, 30.0, family="frequency"),
        Place("level", None, None, None, 1.0, 14.0, family="level", level=0.35),
    )
    tables = content_of(comparison(), None, refinement(regions=regions, regions_by_kind=kinds)).places
    assert [(table.title, table.folded) for table in tables] == [
        ("by frequency", False), ("by drive level", False), ("by frequency, record by record", True),
    ]  # fmt: skip
    assert (tables[0].rows[0].error_after, tables[0].rows[0].explained) == (1.0, 0.98)
    assert [row.share for row in tables[2].rows] == [0.7, 0.2]
    assert tables[1].rows[0].place == "0.35 of the largest level"


def test_theta_shifts_by_the_angle_between_axes(comparison: Build, refinement: Build) -> None:
    rows = {row.name: row for row in content_of(comparison(), None, refinement()).parameters}
    assert list(rows)[:2] == ["theta_deg", "split_hz"]
    # From 89.9 to -89.9 deg is an angle of 0.2 deg, 2 sd, not of 179.8 deg.
    assert rows["theta_deg"].shift == pytest.approx(2.0)
    assert rows["split_hz"].shift == pytest.approx(10.0)
    assert (rows["cubic_stiffness.k3"].before, rows["cubic_stiffness.k3"].after) == (None, (1.21e9, 2e6))
    assert rows["cubic_stiffness.k3"].unit == "1/(V^2 s^4)"


def test_candidates_are_sorted_by_significance_and_have_the_letter_of_their_class(
    comparison: Build, diagnosis: Build
) -> None:
    content = content_of(comparison(), diagnosis(classes=(("cubic_stiffness", "electrostatic_softening"),)))
    assert [one.effect for one in content.candidates] == ["cubic_stiffness", "angular_rate"]
    assert content.letters == {"cubic_stiffness": "A", "electrostatic_softening": "A"}


def test_a_law_has_its_fitted_size_or_else_its_estimate(comparison: Build, diagnosis: Build, refinement: Build) -> None:
    (law,) = content_of(comparison(), diagnosis()).laws
    assert law.sizes == {"cubic_stiffness.k3": (1.2e9, 2e6)}
    (law,) = content_of(comparison(), diagnosis(), refinement()).laws
    assert law.sizes == {"cubic_stiffness.k3": (1.21e9, 2e6)}
    assert law.effect is not None
    assert law.effect.name == "cubic_stiffness"


def test_units_of_family_members_and_result_quantities_are_found() -> None:
    library = find_effects()
    assert unit_of("c12_per_s", library) == "1/s"
    assert unit_of("quadratic_stiffness.k2x", library) == library["quadratic_stiffness"].parameters[0].unit
    assert unit_of("no_such_effect.f_hz", library) == "Hz"


def _entry(mode: int, share: float, relative: float) -> Place:
    return Place(
        "resonance", "eq14", "sense1", (534.0, 535.0), share, None, mode=mode, drive="drive2", relative_error=relative,
        measured=(0.5, 0.1), model=(0.4, 0.1),
    )  # fmt: skip


def test_a_modal_record_has_entries_and_no_held_out_data(comparison: Build, rung: Build, refinement: Build) -> None:
    compared = comparison(error={"fit": None, "validate": None}, where=(_entry(2, 0.3, 0.09),), dof=19)
    unknown = {"error_fit": None, "error_validate": None, "relative_error_validate": UNSET, "dof": 18}
    ladder = (
        rung(effect=None, relative_error=0.099, **unknown),
        rung(status="partial", relative_error=0.027, **unknown),
    )
    content = content_of(compared, None, refinement(ladder=ladder, where=(_entry(2, 0.6, 0.01),)))
    assert content.modal
    assert content.change == ErrorChange(
        0.099, 0.027, "over the residues at resonance", relative=True, delta_chi2=4.9e5
    )
    (table,) = content.places
    assert (table.rows[0].place, table.rows[0].error, table.rows[0].error_after) == (
        "mode 2 (534.5 Hz), S1/D2",
        0.09,
        0.01,
    )
    assert content.notes[-1] == (
        "Every effect is partial: a modal record has no held-out data. The misfit that remains serves as the noise level."
    )
