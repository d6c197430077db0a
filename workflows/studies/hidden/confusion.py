"""Results of the study: proportions with their confidence intervals, confusion matrix, power curve, run times.

A row is the JSON object of one campaign (``study.examine``).  A named effect is right if it is hidden, or if its class (of at
most three effects) contains a hidden effect.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from pipeline.criticism.budget import DETECTABLE_SNR
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model

from ..coverage import Share
from .kinds import KINDS
from .own_law import without_law

Row = Mapping[str, Any]

_LARGEST_CLASS = 3
#: A larger class counts if chi2 rises by at most this (3 sd of one parameter) with each member in place of the selected one.
_EQUAL_FITS = 9.0
#: Above this SNR an effect must not be missed.
_LOUD_SNR = 30.0
_POWER_BINS = (4.0, 5.0, 6.5, 8.0, 10.0, 20.0, 50.0, 200.0, 1000.0)


def class_of(name: str, result: Mapping[str, Any]) -> set[str]:
    """``name`` and all effects that the result could not distinguish from it."""
    return {name}.union(*(set(members) for members in result["classes"] if name in members))


def answer(row: Row, step: str) -> str:
    """Assessment of ``step`` ("diagnose" or "refine"): "right", "partly", "wrong", "adequate", "unknown" or "fit_failed".

    right   all hidden effects and no others, up to classes of at most three; or none, where it says that the campaign cannot
            show the hidden effect
    partly  only hidden effects (up to classes), but not all of them, or in a larger class
    wrong   at least one named effect whose class contains no hidden effect
    """
    result, hidden = row[step], set(row["hidden"])
    if result["verdict"] in ("unknown", "fit_failed") or not result["effects"]:
        # Only diagnose lists what the campaign cannot show.
        if hidden and result["verdict"] == "adequate" and hidden <= set(row["diagnose"].get("invisible", ())):
            return "right"
        return "adequate" if result["verdict"] in ("adequate", "effect", "class") else str(result["verdict"])
    named = [class_of(name, result) for name in result["effects"]]
    if any(not members & hidden for members in named):
        return "wrong"
    complete = len(named) == len(hidden) and all(any(name in members for members in named) for name in hidden)
    small = all(len(members) <= _LARGEST_CLASS for members in named)
    return "right" if complete and small else "partly"


def look_alike(row: Row) -> bool:
    """Whether the campaign itself shows that what ``refine`` added is like the one hidden effect.

    What it does not reproduce of the noise-free records must be too weak to be detected, in any campaign of these records.
    Where the records differ, there is no noise-free record to compare with: there the refit with the hidden effect itself must
    not be better by as much, and the differences between the records may stand for it alone.
    """
    added = bool(row["refine"]["effects"]) or row["kind"].startswith("bench")
    return added and row["refine"].get("snr_left", np.inf) < DETECTABLE_SNR


def confirmed(row: Row) -> bool:
    """Whether refine has a confirmed rung."""
    return any(rung["status"] == "confirmed" for rung in row["refine"]["ladder"])


def _unknown_and_unconfirmed(row: Row) -> bool:
    return row["refine"]["verdict"] == "unknown" and not confirmed(row)


def share(rows: Sequence[Row], test: Callable[[Row], bool]) -> Share:
    """The proportion of rows that pass ``test``."""
    return Share(sum(test(row) for row in rows), len(rows))


def _assessed(step: str, expected: str) -> Callable[[Row], bool]:
    return lambda row: answer(row, step) == expected


def _z_score(row: Row, quantity: str, key: str) -> float:
    """(estimate - truth)/sd of a quantity in refine, theta modulo 180 deg; nan if there is no estimate."""
    found = row["refine"].get(key)
    if not found or found[0] is None or not found[1]:
        return float("nan")
    deviation = found[0] - row["truth"][quantity]
    if quantity == "theta_deg":
        deviation = (deviation + 90.0) % 180.0 - 90.0
    return float(deviation / found[1])


def main_parameter(row: Row, model: Model = DEFAULT_COMPARE_MODEL) -> tuple[float, float, float] | None:
    """(true, estimate, sd) of the largest hidden parameter among those that are zero without the effect.

    None if refine did not add exactly the hidden effect, or if the fit has no such parameter (hum).
    """
    if len(row["hidden"]) != 1 or list(row["refine"]["effects"]) != list(row["hidden"]):
        return None
    effect = model.effect(row["hidden"][0])
    estimated = [name for name in row["sizes"] if name in row["refine"]["parameters"]]
    if not estimated:
        return None
    name = max(estimated, key=lambda n: abs(row["sizes"][n]))
    value, sd = row["refine"]["parameters"][name]
    if sd is None or not np.isfinite(sd):
        return None
    if (angle := effect.direction(model.built.shape)) is not None:
        # The opposite sense vector with the opposite sign of the other parameters is the same mode.
        full = effect.full_name(angle)
        difference = row["refine"]["parameters"][full][0] - row["truth"][full]
        value *= float(np.sign(np.cos(np.deg2rad(difference)))) or 1.0
    return float(row["sizes"][name]), float(value), float(sd)


def figures(rows: Sequence[Row], model: Model = DEFAULT_COMPARE_MODEL) -> dict[str, Any]:
    """All figures of the study by their description; a figure without rows is omitted."""
    ran = [row for row in rows if not row["failed"]]
    by = {kind: [row for row in ran if row["kind"] == kind] for kind in KINDS}
    out: dict[str, Any] = {"campaigns": len(rows), "campaigns that failed to run": len(rows) - len(ran)}

    def add(what: str, kind: str, test: Callable[[Row], bool]) -> None:
        if by[kind]:
            out[f"{kind}: {what}"] = share(by[kind], test)

    for kind, limit in (("none", 1), ("coloured", 5), ("heavy-tailed", 5), ("louder", 5)):
        add(f"a name (at most {limit} %)", kind, lambda r: bool(r["diagnose"]["effects"]))
        add("unknown", kind, lambda r: r["diagnose"]["verdict"] == "unknown")
    for step in ("diagnose", "refine"):
        add(f"right, {step} (at least 95 %)", "one", _assessed(step, "right"))
        add(f"wrong name, {step} (at most 1 %)", "one", _assessed(step, "wrong"))
    add("wrong name, diagnose (at most 2 %)", "weak", _assessed("diagnose", "wrong"))
    add("right, diagnose", "weak", _assessed("diagnose", "right"))
    add("adequate, diagnose", "weak", _assessed("diagnose", "adequate"))
    for step in ("diagnose", "refine"):
        add(f"both and only both, {step} (at least 85 %)", "two", _assessed(step, "right"))
    if own := [row for row in ran if without_law(row["hidden"])]:
        out["campaigns simulated by the effect's own law, not independently"] = len(own)
    out |= _foreign("outside", by["outside"], model) | _foreign("left-out", by["left-out"], model)
    out |= _foreign("outside and left-out", by["outside"] + by["left-out"], model)
    for group in ("bench", "lone"):
        out |= _of_records(group, by, model)
    out |= _after_adding([r for r in by["one"] if answer(r, "refine") == "right"])
    out |= _sizes(by["one"], model)
    out |= _times(ran)
    return out


def _foreign(name: str, rows: Sequence[Row], model: Model) -> dict[str, Any]:
    """Campaigns whose effect is not offered, with and without those in which a look-alike stands for it."""
    if not rows:
        return {}
    fair = [r for r in rows if _unknown_and_unconfirmed(r) or not look_alike(r)]
    return {
        f"{name}: unknown, no confirmed rung (at least 90 %)": share(fair, _unknown_and_unconfirmed),
        f"{name}: a look-alike stands for it, excused": len(rows) - len(fair),
        f"{name}: unknown, no confirmed rung, none excused": share(rows, _unknown_and_unconfirmed),
        f"{name}: adequate": share(fair, lambda r: r["refine"]["verdict"] == "adequate"),
    }


def _of_records(group: str, by: Mapping[str, Sequence[Row]], model: Model) -> dict[str, Any]:
    """Figures of the kinds of a group, "bench" or "lone", whose records set limits of their own."""
    none, one, foreign = (by[f"{group}-{what}"] for what in ("none", "one", "foreign"))
    limits = {"bench": ("1", "92", "1.5"), "lone": ("2", "90", "3")}[group]
    out: dict[str, Any] = {}
    if none:
        out[f"{group}-none: a name (at most {limits[0]} %)"] = share(none, lambda r: bool(r["diagnose"]["effects"]))
        adequate = f"{group}-none: adequate" + (" (at least 95 %)" if group == "bench" else "")
        out[adequate] = share(none, lambda r: r["diagnose"]["verdict"] == "adequate")
    if one:
        out[f"{group}-one: right, or an honest class (at least {limits[1]} %)"] = share(one, is_honest)
        out[f"{group}-one: a single wrong name (at most {limits[2]} %)"] = share(one, _assessed("refine", "wrong"))
        loud = [r for r in one if r["snr"][0] > _LOUD_SNR]
        limit = " (at most 2 %)" if group == "lone" else ""
        adequate = f"{group}-one: adequate, SNR above {_LOUD_SNR:.0f}{limit}"
        out[adequate] = share(loud, lambda r: answer(r, "refine") == "adequate")
    return out | _foreign(f"{group}-foreign", foreign, model)


def is_honest(row: Row) -> bool:
    """Whether ``refine`` named the one hidden effect, or a class that contains it, and nothing else.

    A class of more than three effects counts where every member fits within ``_EQUAL_FITS`` of the selected one.  With records
    that differ, an effect that is not seen counts if it could not reach the lowest SNR of its kind within its declared range, or
    is said to be invisible in these records.
    """
    found = row["refine"]
    if answer(row, "refine") == "right" and not found["effects"]:
        return True
    if answer(row, "refine") in ("right", "partly") and len(found["effects"]) == 1:
        rises = found.get("class_delta_chi2") or [None]
        small = all(len(one) <= _LARGEST_CLASS for one in found["classes"])
        return small or all(rise is not None and rise <= _EQUAL_FITS for rise in rises)
    faint = KINDS[row["kind"]].bench and row["snr"][0] < KINDS[row["kind"]].snr[0]
    return faint and answer(row, "refine") == "adequate"


def _after_adding(rows: Sequence[Row]) -> dict[str, Any]:
    if not rows:
        return {}
    out: dict[str, Any] = {}
    error = [r["refine"]["ladder"][-1]["error_validate"] for r in rows]
    out["after adding: held-out error at most 1.01 (at least 95 %)"] = Share(
        sum(e is not None and e <= 1.01 for e in error), len(rows)
    )
    for quantity, before in (("theta_deg", "theta_before_deg"), ("split_hz", "split_before_hz")):
        z = np.array([_z_score(r, quantity, quantity) for r in rows])
        earlier = np.array([_z_score(r, quantity, before) for r in rows])
        inside = int(np.sum(np.abs(z) <= 1.6449))
        out[f"after adding: {quantity} inside its 90 % interval (85 to 95 %)"] = Share(inside, len(rows))
        if np.any(np.isfinite(earlier)):
            out[f"before adding: {quantity} off by more than 3 sd"] = Share(
                int(np.sum(np.abs(earlier) > 3.0)), len(rows)
            )
    return out


def _sizes(rows: Sequence[Row], model: Model) -> dict[str, Any]:
    found = [size for row in rows if (size := main_parameter(row, model)) is not None]
    if not found:
        return {}
    return {
        "size: sign right (at least 99 %)": Share(sum(true * value > 0.0 for true, value, _ in found), len(found)),
        "size: inside its 95 % interval (91 to 98 %)": Share(
            sum(abs(value - true) <= 1.96 * sd for true, value, sd in found), len(found)
        ),
    }


def _times(rows: Sequence[Row]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for step, median, worst in (("diagnose", 5, None), ("refine", 20, 60)):
        seconds = [row[step]["seconds"] for row in rows if row[step]]
        if seconds:
            out[f"{step}: median time, s (at most {median})"] = float(np.median(seconds))
            out[f"{step}: worst time, s" + (f" (at most {worst})" if worst else "")] = float(np.max(seconds))
            cpu = [row[step]["cpu_seconds"] for row in rows if row[step]]
            out[f"{step}: median time of the processor, s"] = float(np.median(cpu))
    return out


def found_as(row: Row, step: str) -> str:
    """Column of the confusion matrix: named effects with their classes, or the verdict if none is named."""
    result = row[step]
    if result["verdict"] in ("unknown", "fit_failed") or not result["effects"]:
        return "adequate" if result["verdict"] in ("effect", "class") else str(result["verdict"])
    return " + ".join(sorted("/".join(sorted(class_of(name, result))) for name in result["effects"]))


def confusion(rows: Sequence[Row], step: str) -> dict[str, dict[str, int]]:
    """Hidden effects -> found effects -> number of campaigns, for all rows that contain ``step``."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        if not row["failed"] and row[step]:
            left = ", left out" if row["left_out"] else ""
            hidden = f"{row['kind']}: {' + '.join(row['hidden']) or 'nothing'}{left}"
            table.setdefault(hidden, Counter())[found_as(row, step)] += 1
    return {hidden: dict(found.most_common()) for hidden, found in sorted(table.items())}


def power(rows: Sequence[Row]) -> list[tuple[float, float, dict[str, int]]]:
    """(lowest SNR, highest SNR, assessment -> number of campaigns) of the campaigns with one hidden effect."""
    single = [row for row in rows if row["kind"] in ("one", "weak") and not row["failed"]]
    out = []
    for low, high in pairwise(_POWER_BINS):
        inside = [row for row in single if low <= row["snr"][0] < high]
        out.append((low, high, dict(Counter(answer(row, "diagnose") for row in inside))))
    return out


def is_unexpected(row: Row) -> bool:
    """Whether a campaign failed to run or did not give the expected verdict."""
    if row["failed"]:
        return True
    if not row["hidden"]:
        return row["diagnose"]["verdict"] != "adequate"
    if row["left_out"] or row["kind"] == "outside":
        return row["refine"]["verdict"] != "unknown" or confirmed(row)
    steps = [step for step in ("diagnose", "refine") if row[step]]
    return any(answer(row, step) != "right" for step in steps)
