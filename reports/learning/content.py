"""The content of a campaign's page: frozen data from the JSON of compare, diagnose and refine; no HTML, no figures.

Keys that are absent give "not known", keys that are unknown are ignored: the page never fails for them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..run.content import Fact, facts
from ..words.campaign import Fall, fall_sentence, missing_sentence, noise_sentence, standing_notes
from ..words.quantities import percent
from .rows import (
    CandidateRow,
    Json,
    Law,
    Library,
    ParameterRow,
    Region,
    Rung,
    candidates_of,
    classes_of,
    finite,
    kinds_of,
    last_rung,
    laws_of,
    letter,
    mapping,
    misfit_of,
    names_of,
    parameters_of,
    regions_of,
    rows_of,
    rung_of,
    wrong_forms_of,
)


@dataclass(frozen=True)
class CampaignContent:
    """Everything that the page says, in its order."""

    device_id: str
    verdict: str
    missing: str
    fell: str
    notes: tuple[str, ...]
    fall: Fall
    fitted: Fall
    misfit: tuple[float | None, float | None]
    explained: float | None
    theta: ParameterRow | None
    split: ParameterRow | None
    verdicts: tuple[str, str]
    rungs: tuple[Rung, ...]
    refused: tuple[tuple[str, str], ...]
    kinds: tuple[Region, ...]
    regions: tuple[tuple[str, tuple[Region, ...]], ...]
    noise: str
    candidates: tuple[CandidateRow, ...]
    classes: tuple[tuple[str, tuple[str, ...]], ...]
    separating: str | None
    invisible: tuple[str, ...]
    parameters: tuple[ParameterRow, ...]
    laws: tuple[Law, ...]
    truth: str
    provenance: tuple[Fact, ...]


def campaign_content(
    device_id: str,
    compare: Json,
    diagnose: Json | None,
    refine: Json | None,
    *,
    library: Library,
    verdicts: Mapping[str, str] | None = None,
    truth: str | None = None,
    provenance: Json | None = None,
) -> CampaignContent:
    """The content of a campaign's page.

    Parameters
    ----------
    device_id : of the campaign.
    compare, diagnose, refine : JSON of the three commands; ``None`` where a command was not run.
    library : effect -> law, signature, source, and units under "unit.<parameter>".
    verdicts : "before" and "after" of the decision.
    truth : what was hidden, where somebody knows.
    provenance : shown as it is.
    """
    told, found = diagnose or {}, refine or {}
    rungs = tuple(rung_of(k, one, library) for k, one in enumerate(rows_of(found.get("ladder"))))
    said = str(found.get("verdict") or told.get("verdict") or ("" if compare.get("fit_ok", True) else "fit_failed"))
    effects = names_of(found.get("effects") if refine else told.get("effects"))
    classes = classes_of(found.get("classes") or told.get("classes"))
    last = next((one for one in reversed(rungs) if one.status != "refused"), None)
    fall, fitted = _fall(compare, rungs, last, held_out=True), _fall(compare, rungs, last, held_out=False)
    shown = fall if (fall.before if fall.before is not None else fall.after) is not None else fitted
    if (shown.before if shown.before is not None else shown.after) is None:
        shown = _relative(compare, rungs, last)
    added = [one.delta_chi2 for one in rungs if one.delta_chi2 is not None and one.status != "refused"]
    shown = replace(shown, chi2=sum(added) if added else None)
    asked = next((one for one in (told, found) if "separating_record" in one), None)
    separating = None if asked is None else str(asked["separating_record"] or "")
    selection = [one.effect for one in rungs if one.effect and one.status != "refused"]
    parameters = parameters_of(compare, found, library)
    by_name = {row.name: row for row in parameters}
    after = mapping(found.get("parameters")) or mapping(last_rung(found).get("parameters"))
    kinds = kinds_of(compare, found)
    of_rungs = {"before": rungs[0].verdict, "after": last.verdict if last and selection else ""} if rungs else {}
    verdict_words = verdicts or of_rungs
    return CampaignContent(
        device_id=device_id,
        verdict=said,
        missing=missing_sentence(said, effects, classes, bool(refine), selection),
        fell=fall_sentence(shown, said),
        notes=_place_note(kinds)
        + standing_notes(
            said,
            classes,
            {one.effect: one.status for one in rungs if one.effect in effects},
            wrong_forms_of(effects, told, found),
            str(found.get("left") or told.get("left") or ""),
            str(found.get("why") or told.get("why") or compare.get("why") or ""),
            separating,
            any(one.error_validate is not None for one in rungs),
        ),
        fall=shown,
        fitted=fitted,
        misfit=(misfit_of(shown.before, shown.relative), misfit_of(shown.after, shown.relative)),
        explained=last.explained if last and last.effect else None,
        theta=by_name.get("theta_deg") if selection else None,
        split=by_name.get("split_hz") if selection else None,
        verdicts=(str(verdict_words.get("before", "")), str(verdict_words.get("after", ""))),
        rungs=rungs,
        refused=tuple((str(name), str(why)) for name, why in mapping(found.get("refused")).items()),
        kinds=kinds,
        regions=regions_of(compare, found),
        noise=noise_sentence(mapping(compare.get("noise"))),
        candidates=candidates_of(told, effects, classes, library),
        classes=tuple((letter(k), members) for k, members in enumerate(classes)),
        separating=separating,
        invisible=names_of(told.get("invisible")),
        parameters=parameters,
        laws=laws_of(effects, selection, classes, after, told, library),
        truth=truth or "",
        provenance=facts(provenance or {}),
    )


def _fall(compare: Json, rungs: Sequence[Rung], last: Rung | None, held_out: bool) -> Fall:
    stated = finite(mapping(compare.get("error")).get("validate" if held_out else "fit"))
    of = (lambda rung: rung.error_validate) if held_out else (lambda rung: rung.error_fit)
    before = of(rungs[0]) if rungs and of(rungs[0]) is not None else stated
    after = of(last) if last is not None and len(rungs) > 1 else None
    return Fall(before, after, held_out)


def _relative(compare: Json, rungs: Sequence[Rung], last: Rung | None) -> Fall:
    stated = mapping(compare.get("relative_error"))
    fit = finite(stated.get("fit"))
    before = rungs[0].relative_error if rungs and rungs[0].relative_error is not None else fit
    after = last.relative_error if last is not None and len(rungs) > 1 else None
    held = finite(stated.get("validate"))
    if after is None and held is not None:
        return Fall(held, None, True, relative=True)
    return Fall(before, after, False, relative=True)


def _place_note(kinds: Sequence[Region]) -> tuple[str, ...]:
    """Where most of the misfit lies, for the head."""
    if not kinds:
        return ()
    return (f"Where the model as given fails: {percent(kinds[0].share)} of its misfit is in {kinds[0].place}.",)
