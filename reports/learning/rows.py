"""Rows of a campaign's page from the JSON of compare, diagnose and refine.

Absent keys give ``None`` or "", unknown keys are ignored, and what is not a finite number is not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.axial import difference
from pipeline.quantities import AXES

from ..words.campaign import FREQUENCY_KINDS, effect_words, region_words
from ..words.quantities import UNITS, label

Json = Mapping[str, Any]
#: effect -> law, signature, source, and units under "unit.<parameter>".
Library = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class Value:
    """An estimate with its sd (nan where not known) and unit."""

    name: str
    value: float
    sd: float
    unit: str


@dataclass(frozen=True)
class Rung:
    """One model of the ladder; ``None`` where a number is not known."""

    name: str
    effect: str
    status: str
    error_fit: float | None
    error_validate: float | None
    misfit_fit: float | None
    misfit_validate: float | None
    relative_error: float | None
    delta_chi2: float | None
    explained: float | None
    held_fall: float | None
    held_sd: float | None
    theta: Value | None
    split: Value | None
    verdict: str
    at_face: str
    reason: str
    dropped: tuple[str, ...]
    by_kind: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Region:
    """Where the model fails: family and place, share of its family, error before, share explained, error after."""

    family: str
    place: str
    share: float
    error: float | None
    explained: float | None
    error_after: float | None


@dataclass(frozen=True)
class CandidateRow:
    """An absent effect; ``group`` is the letter of its class, ``seen`` yes, no or "" where nothing was said."""

    effect: str
    delta_chi2: float
    p_value: float | None
    estimate: tuple[Value, ...]
    error_after: float | None
    group: str
    seen: str
    snr: float | None
    flag: str
    named: bool


@dataclass(frozen=True)
class ParameterRow:
    """A parameter before and after; ``shift`` in sds of before."""

    name: str
    unit: str
    before: Value | None
    after: Value | None
    shift: float | None


@dataclass(frozen=True)
class Law:
    """The physics of one effect, and its sizes on this device."""

    effect: str
    law: str
    signature: str
    source: str
    sizes: tuple[Value, ...]


def finite(value: Any) -> float | None:
    """A finite number, or ``None``."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def mapping(value: Any) -> Json:
    return value if isinstance(value, Mapping) else {}


def rows_of(value: Any) -> list[Json]:
    return [row for row in value if isinstance(row, Mapping)] if isinstance(value, Sequence) else []


def names_of(value: Any) -> tuple[str, ...]:
    return tuple(str(name) for name in value) if isinstance(value, Sequence) and not isinstance(value, str) else ()


def classes_of(value: Any) -> tuple[tuple[str, ...], ...]:
    groups = value if isinstance(value, Sequence) and not isinstance(value, str) else ()
    return tuple(members for members in map(names_of, groups) if len(members) > 1)


def letter(k: int) -> str:
    return chr(ord("A") + k % 26)


def last_rung(refine: Json) -> Json:
    kept = [row for row in rows_of(refine.get("ladder")) if row.get("status") != "refused"]
    return kept[-1] if kept else {}


def misfit_of(error: float | None, relative: bool = False) -> float | None:
    return None if error is None or relative else math.sqrt(max(error * error - 1.0, 0.0))


def _value(name: str, pair: Any, unit: str) -> Value | None:
    """[value, sd], or a number."""
    row = pair if isinstance(pair, Sequence) and not isinstance(pair, str) else [pair]
    value = finite(row[0]) if row else None
    sd = finite(row[1]) if len(row) > 1 else None
    return None if value is None else Value(name, value, math.nan if sd is None else sd, unit)


def _unit(name: str, effect: str, library: Library) -> str:
    if name in UNITS:
        return UNITS[name]
    owner, dot, short = name.rpartition(".")
    entry = library.get(owner if dot else effect, {})
    unit = entry.get(f"unit.{short if dot else name}") or next(
        # Members of a family carry a suffix: k2x of k2, C_s1d2 of C.
        (u for key, u in entry.items() if key.startswith("unit.") and name.rpartition(".")[2].startswith(key[5:])),
        "Hz" if name.endswith("_hz") else "deg" if name.endswith("_deg") else "",
    )
    return "" if unit == "1" else unit


def rung_of(k: int, row: Json, library: Library) -> Rung:
    effect = str(row.get("effect") or "")
    inside = {**mapping(row.get("parameters")), **mapping(row.get("derived"))}
    by_kind = ((str(kind), finite(share)) for kind, share in mapping(row.get("explained_by_kind")).items())
    error_fit, error_validate = finite(row.get("error_fit")), finite(row.get("error_validate"))

    def misfit(key: str, error: float | None) -> float | None:
        given = finite(row.get(key))
        return given if given is not None else misfit_of(error)

    return Rung(
        name=f"+ {effect_words(effect)}" if effect else ("model as given" if k == 0 else "–"),
        effect=effect,
        status=str(row.get("status") or ""),
        error_fit=error_fit,
        error_validate=error_validate,
        misfit_fit=misfit("misfit_fit", error_fit),
        misfit_validate=misfit("misfit_validate", error_validate),
        relative_error=finite(row.get("relative_error")),
        delta_chi2=finite(row.get("delta_chi2")) if effect else None,
        explained=finite(row.get("explained", row.get("share_explained"))) if effect else None,
        held_fall=finite(row.get("held_out_fall")),
        held_sd=finite(row.get("held_out_sd")),
        theta=_value("theta_deg", row.get("theta_deg", inside.get("theta_deg")), UNITS["theta_deg"]),
        split=_value("split_hz", row.get("split_hz", inside.get("split_hz")), UNITS["split_hz"]),
        verdict=str(row.get("verdict") or ""),
        at_face=str(row.get("verdict_at_face") or ""),
        reason=str(row.get("verdict_reason") or ""),
        dropped=names_of(row.get("dropped")),
        by_kind=tuple((kind, share) for kind, share in by_kind if share is not None) if effect else (),
    )


def regions_of(compare: Json, refine: Json) -> tuple[tuple[str, tuple[Region, ...]], ...]:
    """Regions by family, the largest share first; with what a ladder left of them where there is one."""
    families: dict[str, list[Region]] = {}
    for row in rows_of(refine.get("regions")) or rows_of(compare.get("where")):
        kind = str(row.get("kind") or "region")
        family = str(row.get("family") or ("frequency" if kind in FREQUENCY_KINDS else kind))
        families.setdefault(family, []).append(_region(family, row))
    return tuple((family, tuple(sorted(found, key=lambda one: -one.share))) for family, found in families.items())


def kinds_of(compare: Json, refine: Json) -> tuple[Region, ...]:
    """The cut by frequency with all records and channels together, the largest share first."""
    rows = rows_of(refine.get("regions_by_kind")) or rows_of(compare.get("where_by_kind"))
    return tuple(sorted((_region("frequency", row) for row in rows), key=lambda one: -one.share))


def _region(family: str, row: Json) -> Region:
    error, explained, left = (finite(row.get(key)) for key in ("error", "explained", "error_after"))
    if left is None and error is not None and explained is not None:
        left = math.sqrt(max(1.0 + (error**2 - 1.0) * (1.0 - explained), 0.0))
    return Region(family, region_words(row), finite(row.get("share")) or 0.0, error, explained, left)


def candidates_of(
    diagnose: Json,
    effects: Sequence[str],
    classes: Sequence[Sequence[str]],
    library: Library,
) -> tuple[CandidateRow, ...]:
    letters = {name: letter(k) for k, members in enumerate(classes) for name in members}
    found = []
    for row in rows_of(diagnose.get("candidates")):
        name = str(row.get("effect") or "")
        seen = row.get("could_have_shown", row.get("detectable"))
        sizes = (_value(str(k), v, _unit(str(k), name, library)) for k, v in mapping(row.get("estimate")).items())
        found.append(
            CandidateRow(
                effect=name,
                delta_chi2=finite(row.get("delta_chi2")) or 0.0,
                p_value=finite(row.get("p_value")),
                estimate=tuple(one for one in sizes if one is not None),
                error_after=finite(row.get("error_after")),
                group=letters.get(name, ""),
                seen="" if not isinstance(seen, bool) else "yes" if seen else "no",
                snr=finite(row.get("expected_snr", row.get("snr_at_reach"))),
                flag=str(row.get("flag") or ""),
                named=name in effects,
            )
        )
    return tuple(sorted(found, key=lambda one: (one.p_value if one.p_value is not None else 1.0, -one.delta_chi2)))


def wrong_forms_of(effects: Sequence[str], diagnose: Json, refine: Json) -> dict[str, str]:
    """Effects flagged "right place, wrong form", each with the partition on which its sizes disagree, "" where unsaid."""
    told = mapping(refine.get("wrong_form") or diagnose.get("wrong_form"))
    flagged = {str(name): str(mapping(how).get("by") or "") for name, how in told.items()}
    for row in (*rows_of(refine.get("ladder")), *rows_of(diagnose.get("candidates"))):
        name = str(row.get("effect") or "")
        if name in effects and "wrong form" in str(row.get("flag") or ""):
            flagged.setdefault(name, "")
    return flagged


def parameters_of(compare: Json, refine: Json, library: Library) -> tuple[ParameterRow, ...]:
    """theta and split first, then the parameters in their order, new ones last."""
    ladder = rows_of(refine.get("ladder"))
    first = {**mapping(ladder[0].get("parameters") if ladder else None), **mapping(compare.get("parameters"))}
    last = {**mapping(last_rung(refine).get("parameters")), **mapping(refine.get("parameters"))} if refine else {}
    for name in ("theta_deg", "split_hz"):
        bare = name.rpartition("_")
        early = refine.get(f"{bare[0]}_before_{bare[2]}", ladder[0].get(name) if ladder else None)
        if early is not None:
            first[name] = early
        if refine.get(name) is not None:
            last[name] = refine[name]
    order = list(dict.fromkeys([*(n for n in ("theta_deg", "split_hz") if n in {*first, *last}), *first, *last]))
    rows = []
    for name in map(str, order):
        unit = _unit(name, "", library)
        before, after = _value(name, first.get(name), unit), _value(name, last.get(name), unit)
        shift = None
        if before is not None and after is not None and before.sd > 0.0:
            moved = difference(after.value, before.value) if name in AXES else after.value - before.value
            shift = float(moved) / before.sd
        rows.append(ParameterRow(name, unit, before, after, shift))
    return tuple(row for row in rows if row.before is not None or row.after is not None)


def laws_of(
    effects: Sequence[str],
    selection: Sequence[str],
    classes: Sequence[Sequence[str]],
    after: Json,
    diagnose: Json,
    library: Library,
) -> tuple[Law, ...]:
    """Laws of what was added or named, of the rungs on the way, and of the members of their classes."""
    wanted = list(dict.fromkeys([*effects, *selection, *(name for members in classes for name in members)]))
    estimates = {str(row.get("effect")): mapping(row.get("estimate")) for row in rows_of(diagnose.get("candidates"))}
    laws = []
    for name in wanted:
        entry = library.get(name, {})
        # offdiagonal_damping has a result quantity for a parameter, so that its name is the candidate's to tell.
        own = estimates.get(name, {})
        sizes = {k: v for k, v in after.items() if k in own or str(k).startswith(f"{name}.")} or own
        values = (_value(str(k).rpartition(".")[2], v, _unit(str(k), name, library)) for k, v in sizes.items())
        laws.append(
            Law(
                name,
                entry.get("law", ""),
                entry.get("signature", ""),
                entry.get("source", ""),
                tuple(one for one in values if one is not None),
            )
        )
    return tuple(laws)


def short_name(name: str) -> str:
    """The symbol of a parameter: "cubic_stiffness.k3" is "k3", "c12_per_s" is "c12"."""
    symbol = name.rpartition(".")[2]
    return next((symbol.removesuffix(end) for end in ("_per_s", "_hz", "_deg") if symbol.endswith(end)), symbol)


def parameter_label(name: str) -> str:
    """A parameter in words: "cubic_stiffness.k3" is "cubic stiffness: k3"."""
    effect, dot, short = name.rpartition(".")
    return f"{effect_words(effect)}: {short}" if dot else label(name)
