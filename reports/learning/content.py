"""Content of the page of compare, diagnose and refine: frozen data from the typed answers; no HTML, no figures.

answers, effects -> LearningContent -> figures, templates

Campaigns and modal records have the same content; a part that does not apply is empty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.axial import difference
from pipeline.device.effect import Effect
from pipeline.learning.answers import (
    CandidateAnswer,
    ComparisonAnswer,
    DiagnosisAnswer,
    Measured,
    Place,
    RefinementAnswer,
    RungAnswer,
    Values,
)
from pipeline.quantities import AXES

from ..words import campaign as words
from ..words.campaign import ErrorChange
from ..words.quantities import family_words, place_words, unit_of
from ..words.records import record_sentences

#: Families of a few places that cut the whole campaign or modal record.
_WHOLE = ("level", "direction", "channel", "record", "entry")


@dataclass(frozen=True)
class PlaceRow:
    """A place in words, its share of the misfit, the error of the first and of the last model there, the explained share.

    Errors are in sigmas; that of an entry of a modal record is relative to the norm of its mode.
    """

    place: str
    share: float
    error: float | None
    error_after: float | None
    explained: float | None


@dataclass(frozen=True)
class PlaceTable:
    """Places whose shares add up to one, the largest first; a ``folded`` table opens with a click."""

    title: str
    rows: tuple[PlaceRow, ...]
    folded: bool


@dataclass(frozen=True)
class ParameterRow:
    """(value, sd) of a parameter in the first and in the last model, in its unit; ``shift`` in sds of the first."""

    name: str
    unit: str
    before: Measured | None
    after: Measured | None
    shift: float | None


@dataclass(frozen=True)
class LawText:
    """An effect and its sizes on this device; ``effect`` is ``None`` where the library does not have it."""

    name: str
    effect: Effect | None
    sizes: Values


@dataclass(frozen=True)
class LearningContent:
    """What the page states: the answers, and what follows from them.

    Parameters
    ----------
    name : of the device or of the modal record.
    comparison, diagnosis, refinement : the answers; ``None`` where the question was not asked.
    verdict : of the last rung or of the diagnosis; "" where the model was only compared.
    headline, notes : the verdict in words, and what a reader must know beside it.
    change, fitted : the error of the first and of the last model on the data of the headline, and on the fitted data.
    effects : added or named.
    places : where the first model fails.
    candidates, letters : absent effects, the most significant first; effect -> letter of its class.
    parameters, laws : parameters of the first and the last model; the effects in question.
    """

    name: str
    comparison: ComparisonAnswer
    diagnosis: DiagnosisAnswer | None
    refinement: RefinementAnswer | None
    verdict: str
    effects: tuple[str, ...]
    headline: str
    notes: tuple[str, ...]
    change: ErrorChange
    fitted: ErrorChange
    places: tuple[PlaceTable, ...]
    candidates: tuple[CandidateAnswer, ...]
    letters: Mapping[str, str]
    parameters: tuple[ParameterRow, ...]
    laws: tuple[LawText, ...]

    @property
    def modal(self) -> bool:
        """Whether the measurement is a modal record."""
        return bool(self.comparison.dof)

    @property
    def noise_known(self) -> bool:
        """Whether there are errors in sigmas, not only relative ones."""
        return self.comparison.error.get("fit") is not None

    @property
    def ladder(self) -> tuple[RungAnswer, ...]:
        """The models of the ladder; none where nothing was refined."""
        return self.refinement.ladder if self.refinement else ()


def learning_content(
    name: str,
    comparison: ComparisonAnswer,
    diagnosis: DiagnosisAnswer | None,
    refinement: RefinementAnswer | None,
    library: Mapping[str, Effect],
) -> LearningContent:
    """The content of the page.

    Parameters
    ----------
    name, comparison, diagnosis, refinement : as of :class:`LearningContent`.  Where both are given, ``refinement`` has the
        verdict and ``diagnosis`` the candidates of the first model.
    library : effects by name.
    """
    last, ladder = refinement or diagnosis, refinement.ladder if refinement else ()
    verdict = last.verdict if last else "" if comparison.error else "fit_failed"
    effects = last.effects if last else ()
    classes = tuple(members for members in (last.classes if last else ()) if len(members) > 1)
    candidates = diagnosis.candidates if diagnosis else ()
    tried = tuple(rung.effect for rung in ladder if rung.effect)
    change, fitted = _changes(comparison, ladder)
    places = _places(comparison, refinement)
    headline = words.missing_sentence(
        verdict,
        effects,
        classes,
        added=refinement is not None,
        tried=tried,
        imitating=last.imitating if last else (),
        noise_known=comparison.error.get("fit") is not None,
        louder=last.noise_louder or None if last else None,
        data="residues" if comparison.dof else "records",
    )
    return LearningContent(
        name,
        comparison,
        diagnosis,
        refinement,
        verdict,
        effects,
        headline,
        notes=_notes(comparison, last, places),
        change=change,
        fitted=fitted,
        places=places,
        candidates=tuple(sorted(candidates, key=lambda one: (one.p_value, -one.delta_chi2))),
        letters={name: chr(ord("A") + k) for k, members in enumerate(classes) for name in members},
        parameters=_parameters(comparison, ladder, library),
        laws=_laws([*effects, *tried, *(one for members in classes for one in members)], candidates, ladder, library),
    )


def _changes(comparison: ComparisonAnswer, ladder: Sequence[RungAnswer]) -> tuple[ErrorChange, ErrorChange]:
    """The change of the headline (held out rather than fitted, in sigmas rather than relative), and of the fitted error."""
    held_out, fitted = "on the held-out records", "on the fitted records"
    error, relative = comparison.error, comparison.relative_error
    choices = (
        _ends([rung.error_validate for rung in ladder], error.get("validate"), held_out),
        _ends([rung.error_fit for rung in ladder], error.get("fit"), fitted),
        _ends([rung.relative_error_validate or None for rung in ladder], relative.get("validate"), held_out, True),
        _ends([rung.relative_error for rung in ladder], relative.get("fit"), fitted, True),
    )
    found = next((one for one in choices if one.known and (one.after is not None or len(ladder) < 2)), choices[-1])
    where = "over the residues at resonance" if comparison.dof else found.where
    added = sum(rung.delta_chi2 for rung in ladder[1:])
    return replace(found, where=where, delta_chi2=added or None), choices[1]


def _ends(errors: Sequence[float | None], compared: float | None, where: str, relative: bool = False) -> ErrorChange:
    first = errors[0] if errors and errors[0] is not None else compared
    return ErrorChange(first, errors[-1] if len(errors) > 1 else None, where, relative)


def _notes(
    comparison: ComparisonAnswer, last: DiagnosisAnswer | RefinementAnswer | None, places: Sequence[PlaceTable]
) -> tuple[str, ...]:
    model = words.FIRST_MODEL if isinstance(last, RefinementAnswer) and len(last.ladder) > 1 else "model"
    first = [words.largest_place_sentence(table.rows[0].place, table.rows[0].share, model) for table in places[:1]]
    if comparison.error and not comparison.fit_ok:
        first.append(words.UNCONVERGED)
    if last is None and not comparison.error:
        first.append(words.failure_sentence(comparison.why or ""))
    return (*first, *(words.notes(last) if last else record_sentences(comparison)))


def _places(comparison: ComparisonAnswer, refinement: RefinementAnswer | None) -> tuple[PlaceTable, ...]:
    """The cut by frequency over all records first, then one table for each family."""
    kinds = (refinement.regions_by_kind if refinement else ()) or comparison.where_by_kind or ()
    after = {place_words(one): one for one in (refinement.where or ())} if refinement else {}
    families: dict[str, list[PlaceRow]] = {}
    for place in (refinement.regions if refinement else ()) or comparison.where:
        families.setdefault(place.family or "entry", []).append(_place_row(place, after))
    tables = [_table("by frequency", [_place_row(one, {}) for one in kinds])] if kinds else []
    for name in sorted(families, key=lambda name: name not in _WHOLE):
        folded = bool(kinds) and name not in _WHOLE
        each = ", record by record" if folded and name != "response" else ""
        tables.append(_table(f"by {family_words(name)}{each}", families[name], folded))
    return tuple(tables)


def _table(title: str, rows: Sequence[PlaceRow], folded: bool = False) -> PlaceTable:
    return PlaceTable(title, tuple(sorted(rows, key=lambda row: -row.share)), folded)


def _place_row(place: Place, after: Mapping[str, Place]) -> PlaceRow:
    """``after``: entries of a modal record with the last model."""
    text = place_words(place)
    if place.mode:
        left = after[text].relative_error or None if text in after else None
        return PlaceRow(text, place.share, place.relative_error or None, left, None)
    explained = place.explained if isinstance(place.explained, float) else None
    return PlaceRow(text, place.share, place.error, place.error_after or None, explained)


def _parameters(
    comparison: ComparisonAnswer, ladder: Sequence[RungAnswer], library: Mapping[str, Effect]
) -> tuple[ParameterRow, ...]:
    """theta and split first, then the parameters in their order, new ones last."""
    derived = {"theta_deg": comparison.theta_deg, "split_hz": comparison.split_hz}
    first: dict[str, Measured] = {name: value for name, value in derived.items() if value}
    first |= {**(ladder[0].derived if ladder else {}), **comparison.parameters}
    last: Values = {**ladder[-1].parameters, **ladder[-1].derived} if len(ladder) > 1 else {}
    leading = [name for name in derived if name in {**first, **last}]
    return tuple(
        ParameterRow(name, unit_of(name, library), first.get(name), last.get(name), _shift(name, first, last))
        for name in dict.fromkeys([*leading, *first, *last])
    )


def _shift(name: str, first: Values, last: Values) -> float | None:
    (before, sd), (after, _) = first.get(name, (None, None)), last.get(name, (None, None))
    if before is None or after is None or sd is None or not sd > 0.0:
        return None
    return float(difference(after, before) if name in AXES else after - before) / sd


def _laws(
    names: Sequence[str],
    candidates: Sequence[CandidateAnswer],
    ladder: Sequence[RungAnswer],
    library: Mapping[str, Effect],
) -> tuple[LawText, ...]:
    """Effects with their sizes in the last model, or their estimates where they are not in it."""
    last = ladder[-1].parameters if ladder else {}
    estimates = {one.effect: one.estimate for one in candidates}
    laws = []
    for name in dict.fromkeys(names):
        effect = library.get(name)
        quantities = {parameter.quantity for parameter in effect.parameters} if effect else set()
        fitted = {key: value for key, value in last.items() if key.startswith(f"{name}.") or key in quantities}
        laws.append(LawText(name, effect, fitted or estimates.get(name, {})))
    return tuple(laws)
