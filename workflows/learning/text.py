"""What compare, diagnose and refine say on a terminal and in a notebook, from their JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from pipeline.learning.answers import Noise, Place
from reports.words import campaign as words
from reports.words.quantities import place_words

Said = Mapping[str, Any]
_SHOWN = 6


def number(value: float | None) -> str:
    """Four significant digits."""
    return "unknown" if value is None else f"{value:.4g}"


def noise_sentence(noise: Said) -> str:
    """The noise level."""
    return words.noise_sentence(msgspec.convert(noise, Noise, strict=False) if noise else None)


def region_words(row: Said) -> str:
    """Where a region lies."""
    return place_words(msgspec.convert(row, Place, strict=False))


def compare_text(said: Said) -> list[str]:
    """Errors, noise, and where the misfit lies."""
    if not said["error"] and not said["fit_ok"]:
        return [f"the model could not be fitted: {said.get('why') or 'no reason given'}"]
    error, relative = said["error"], said["relative_error"]
    lines = [
        f"error {number(error.get('fit'))} on fitted, {number(error.get('validate'))} on held-out records"
        f" (1 is the noise); relative error {number(relative.get('fit'))}, {number(relative.get('validate'))}",
        noise_sentence(said.get("noise", {})),
    ]
    if not said["fit_ok"]:
        lines.append("the fit did not converge, or the records do not determine every parameter")
    total = said.get("where_by_kind", ())
    if not said.get("where"):
        return [*lines, "no region stands out of the noise"]
    lines += [_share(row) for row in total[:_SHOWN]]
    places = [row for row in said["where"] if row["family"] == "frequency"]
    if places:
        lines.append("most of it in")
        lines += [_share(row) for row in sorted(places, key=lambda row: -row["share"])[:_SHOWN]]
    return lines


def _share(row: Said) -> str:
    return f"  {100.0 * row['share']:5.1f} % of the misfit: {region_words(row)}, error {number(row['error'])}"


def diagnose_text(said: Said) -> list[str]:
    """The verdict and the first candidates."""
    lines = [verdict_sentence(said["verdict"], said["effects"], said["classes"])]
    for c in said["candidates"][:_SHOWN]:
        size = ", ".join(f"{k} = {v[0]:.4g} +- {_sd(v[1])}" for k, v in c["estimate"].items())
        lines.append(f"  {c['effect']:24s} chi2 falls by {c['delta_chi2']:.4g}, p {_p(c['p_value'])}; {size}")
    for name, how in said.get("wrong_form", {}).items():
        lines.append(f"right place, wrong form: the size of {name} disagrees by {how['by']}")
    lines += _separating(said)
    lines += said.get("hints", ())
    if said.get("invisible"):
        lines.append(f"invisible here: {', '.join(said['invisible'])}")
    return lines


def _separating(said: Said) -> list[str]:
    record = said.get("separating_record")
    return [f"a record that would separate them: {record}"] if record else []


def _p(p_value: float | None) -> str:
    return "unknown" if p_value is None else f"{p_value:.2g}" if p_value >= 1e-99 else "< 1e-99"


def _sd(sd: float | None) -> str:
    return "?" if sd is None or not math.isfinite(sd) else format(sd, ".2g")


def verdict_sentence(verdict: str, effects: Sequence[str], classes: Sequence[Sequence[str]]) -> str:
    """The verdict in one line."""
    if verdict == "adequate" and not effects:
        return "adequate: nothing more is missing"
    if verdict == "unknown":
        return "unknown: a misfit is left that no effect of the library explains"
    if verdict == "fit_failed":
        return "fit_failed: the model could not be fitted, so nothing can be said"
    others = "; ".join(" or ".join(c) for c in classes)
    told = f"{verdict}: {', '.join(effects)}"
    if verdict == "adequate":
        told = f"adequate: with {', '.join(effects)} nothing more is missing"
    return told + (f" (these data cannot tell apart: {others})" if others else "")


def _volts_text(rungs: Sequence[Said]) -> list[str]:
    """A rung a line where no noise level is known: relative error, and rms of (measured - model) in every record."""
    lines = ["rung                      status      relative error   rms left in each record"]
    for rung in rungs:
        left = ", ".join(f"{name} {1e3 * volts:.3g} mV" for name, volts in rung.get("error_v", {}).items())
        name, relative = rung["effect"] or "(the model as given)", number(rung.get("relative_error"))
        lines.append(f"{name:24s}  {rung['status'] or '':10s}  {relative:>14s}   {left}")
    return lines


def ladder_text(said: Said) -> list[str]:
    """A rung a line, the misfit as a bar on a logarithmic scale; then the verdict, and what became of theta and the device."""
    rungs = said["ladder"]
    most = max([r.get("misfit_fit") or 0.0 for r in rungs] + [1.0])
    lines = ["rung                      status      error fitted  held-out   misfit"] if rungs else []
    if rungs and all(rung.get("error_fit") is None for rung in rungs):
        lines, rungs = _volts_text(rungs), []
    for rung in rungs:
        misfit = rung.get("misfit_fit") or 0.0
        length = round(30 * max(0.0, math.log10(max(misfit, 1e-2) / 1e-2)) / math.log10(most / 1e-2))
        name = rung["effect"] or "(the model as given)"
        lines.append(
            f"{name:24s}  {rung['status'] or '':10s}  {number(rung.get('error_fit')):>12s}"
            f"  {number(rung.get('error_validate')):>8s}   {'#' * length}"
        )
    lines.append(verdict_sentence(said["verdict"], said["effects"], said["classes"]))
    if said["verdict"] == "fit_failed" and said.get("why"):
        lines.append(said["why"])
    lines += _separating(said)
    lines += said.get("hints", ())
    for name, how in said.get("wrong_form", {}).items():
        lines.append(f"right place, wrong form: the size of {name} disagrees by {how['by']}")
    theta, before = said.get("theta_deg"), said.get("theta_before_deg")
    if theta and before:
        lines.append(f"theta {before[0]:.4f} +- {before[1]:.2g} deg before, {theta[0]:.4f} +- {theta[1]:.2g} deg after")
    verdicts = [str(rung["verdict"]) for rung in said["ladder"] if rung.get("verdict")]
    if verdicts:
        lines.append(f"device {verdicts[0]} before, {verdicts[-1]} after (the shipped limits)")
    if said.get("noise", {}).get("from", "silent") != "silent":
        lines.append(noise_sentence(said["noise"]))
    return lines
