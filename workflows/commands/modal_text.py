"""What compare, diagnose and refine of a modal record say on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_SHOWN = 6


def modal_text(question: str, said: Mapping[str, Any]) -> list[str]:
    """Lines for "compare", "diagnose" or "refine"; ``said`` is their JSON."""
    if said.get("verdict") == "fit_failed" or not said.get("fit_ok", True):
        return [f"the model could not be fitted: {said.get('why') or 'no reason given'}"]
    return {"compare": _compare, "diagnose": _diagnose, "refine": _refine}[question](said)


def _compare(said: Mapping[str, Any]) -> list[str]:
    error = said["error"].get("fit")
    shown = "noise unknown" if error is None else f"error {error:.4g}"
    lines = [f"relative error {percent(said['relative_error']['fit'])} of the residues at resonance, {shown}"]
    for one in said["where"][:_SHOWN]:
        lines.append(
            f"  {100 * one['share']:5.1f} % of the misfit: mode {one['mode']} "
            f"({sum(one['band_hz']) / 2:.1f} Hz), {one['channel']} from {one['drive']}, "
            f"off by {percent(one['relative_error'])} of the mode"
        )
    return [*lines, *_four(said)]


def _diagnose(said: Mapping[str, Any]) -> list[str]:
    lines = [f"relative error {percent(said['relative_error']['fit'])}, {said['dof']} degrees of freedom"]
    for c in said["candidates"]:
        sizes = ", ".join(f"{k} = {v[0]:.4g} +- {_sd(v[1])}" for k, v in c["estimate"].items())
        test = f"F({c['F_dof'][0]}, {c['F_dof'][1]})" if c["F_dof"][1] is not None else f"chi2/{c['F_dof'][0]}"
        lines.append(
            f"  {c['effect']:24s} {test} = {c['F']:6.2f}, p {c['p_single']:.2g} alone, {c['p_value']:.2g} of all; {sizes}"
        )
    for pair in said["pairs"]:
        share = percent(pair["share_of_chi2"])
        lines.append(f"  {' + '.join(pair['effects']):44s} takes {share} of chi2, p {pair['p_value']:.2g} of all pairs")
    if said["declared"]:
        lines.append(f"fixed by what the record declares: {', '.join(said['declared'])}")
    return [*lines, f"not to be seen in a modal record: {', '.join(said['invisible'])}"]


def _refine(said: Mapping[str, Any]) -> list[str]:
    lines = ["rung                      status   rel. error   p of all   theta, deg          spread of the four thetas"]
    for rung in said["ladder"]:
        name = rung["effect"] or "(the model as given)"
        theta = "{:.2f} +- {:.2f}".format(*rung["theta_deg"]) if "theta_deg" in rung else ""
        spread = f"{rung['theta_spread_deg']:.2f} deg" if "theta_spread_deg" in rung else ""
        p = f"{rung['p_value']:.2g}" if "p_value" in rung else ""
        lines.append(
            f"{name:24s}  {rung['status'] or '':8s} {percent(rung['relative_error']):>9s}   {p:>8s}   {theta:18s}  {spread}"
        )
    for name, value in said["parameters"].items():
        lines.append(f"  {name:32s} {value[0]:.6g} +- {_sd(value[1])}")
    return lines


def _four(said: Mapping[str, Any]) -> list[str]:
    if "four_thetas_deg" not in said:
        return []
    shown = ", ".join(f"{value:.2f} +- {sd:.2f}" for value, sd in said["four_thetas_deg"].values())
    return [f"four thetas (u1, v1, u2, v2) {shown} deg, spread {said['theta_spread_deg']:.2f} deg"]


def _sd(sd: float | None) -> str:
    return "?" if sd is None else format(sd, ".2g")


def percent(share: float) -> str:
    """A share in percent."""
    return f"{100.0 * share:.1f} %"
