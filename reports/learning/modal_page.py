"""The page of a modal record: one self-contained HTML file that opens offline.

compare, diagnose, refine (JSON) --figures, template--> HTML
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..html.rendering import environment, measured, number, stylesheet
from ..words.campaign import effect_words, error_words, listed, missing_sentence, p_words, typeset
from .figures.ladder import LadderPoint, ladder_plot
from .figures.modal import AxesPoint, Entry, axes_by_rung, residues
from .rows import parameter_label, parameters_of, short_name

Json = Mapping[str, Any]


def render_modal_report(
    name: str,
    compare: Json,
    diagnose: Json | None,
    refine: Json | None,
    *,
    library: Mapping[str, Mapping[str, str]] | None = None,
) -> str:
    """The page as HTML text; the same input gives the same page.

    Parameters
    ----------
    name : of the modal record.
    compare, diagnose, refine : JSON of the three commands on it; ``None`` where a command was not run.
    library : effect -> law, signature, source (:func:`reports.learning.page.effect_texts`).
    """
    told: Json = refine or diagnose or {}
    rungs: Sequence[Json] = (refine or {}).get("ladder", ())
    classes = told.get("classes", ())
    last = rungs[-1] if rungs else None
    env = environment()
    env.globals.update(
        effect=effect_words, short=short_name, percent_of=lambda v: error_words(v, True), p_words=p_words, listed=listed
    )
    env.filters["effect_of"] = effect_words
    env.globals.update(sized=sized, typeset=typeset, parameter=parameter_label)
    return env.get_template("modal.html.j2").render(
        name=name,
        missing=_missing(told, classes, refine is not None, compare),
        compare=compare,
        diagnose=diagnose,
        refine=refine,
        rungs=rungs,
        last=last,
        parameters=parameters_of(compare, refine or {}, library or {}),
        classes=[members for members in classes if len(members) > 1],
        laws=_laws(told, library or {}),
        figures={
            "residues": residues(entries(compare, refine)),
            "ladder": _ladder(rungs),
            "axes": axes_by_rung(_axes(rungs)) if _axes(rungs) else "",
        },
        stylesheet=stylesheet("campaign.css"),
    )


def sized(value: Sequence[float | None]) -> str:
    """value ± sd."""
    first, sd = value[0], value[1]
    if first is None:
        return "–"
    return measured(first, sd) if sd is not None and sd > 0.0 else number(first, 5)


def entries(compare: Json, refine: Json | None) -> tuple[Entry, ...]:
    """Every entry of every mode, measured and as the first and the last model have it."""
    after = {_place(one): complex(*one["model"]) for one in (refine or {}).get("where", ())}
    shown = [
        Entry(
            int(one["mode"]),
            float(sum(one["band_hz"]) / 2.0),
            entry_name(one),
            complex(*one["measured"]),
            complex(*one["model"]),
            after.get(_place(one)),
        )
        for one in compare.get("where", ())
    ]
    return tuple(sorted(shown, key=lambda entry: (entry.mode, entry.name)))


def entry_name(one: Json) -> str:
    """ "S1/D2" of a place."""
    return f"{one['channel'].replace('sense', 'S')}/{one['drive'].replace('drive', 'D')}"


def _place(one: Json) -> tuple[int, str]:
    return int(one["mode"]), entry_name(one)


def _missing(told: Json, classes: Sequence[Sequence[str]], added: bool, compare: Json) -> str:
    verdict = str(told.get("verdict", ""))
    if verdict == "adequate" and not told.get("effects"):
        known = compare.get("error", {}).get("fit") is not None
        return (
            "Nothing is missing: the residues show no effect beyond the model."
            if known
            else "No effect of the library is significant against what the model leaves."
        )
    tried = [rung["effect"] for rung in told.get("ladder", ()) if rung["effect"]]
    if not verdict:
        return "How well the model explains these poles and residues."
    return missing_sentence(verdict, told.get("effects", ()), classes, added, tried)


def _ladder(rungs: Sequence[Json]) -> str:
    if not rungs:
        return ""
    points = [
        LadderPoint(
            effect_words(rung["effect"]) if rung["effect"] else "the model as given",
            rung["status"] or "",
            rung["relative_error"],
            None,
            None,
            None,
        )
        for rung in rungs
    ]
    return ladder_plot(points, relative=True)


def _axes(rungs: Sequence[Json]) -> list[AxesPoint]:
    return [
        AxesPoint(
            effect_words(rung["effect"]) if rung["effect"] else "the model as given",
            (rung["theta_deg"][0], rung["theta_deg"][1]),
            [(value, sd) for value, sd in rung["four_thetas_deg"].values()],
        )
        for rung in rungs
        if "four_thetas_deg" in rung
    ]


def _laws(told: Json, library: Mapping[str, Mapping[str, str]]) -> list[tuple[str, str, str, str]]:
    """Name, law, signature and source of the named effects and of what could stand for them."""
    named = [*told.get("effects", ())]
    named += [one for members in told.get("classes", ()) for one in members if one not in named]
    return [
        (effect_words(name), library[name]["law"], library[name]["signature"], library[name]["source"])
        for name in named
        if name in library
    ]
