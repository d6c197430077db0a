"""Sentences of a campaign's page, from verdicts and errors.  No HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.quantities import NAMES

from .quantities import PERCENT, SUPERSCRIPT, label, percent

_WORDS = {
    "offdiagonal": "off-diagonal",
    "updown": "up-down",
    "pickoff": "pick-off",
    "adc": "ADC",
}
LIMITED = frozenset(NAMES)
_HELD = "on records the fit had not seen"
#: How a separating record begins that does not exist.
NONE = "none with this instrument"


@dataclass(frozen=True)
class Fall:
    """An error before and after.

    Parameters
    ----------
    before, after : ``None`` where not known.
    held_out : on records that the fit had not seen.
    relative : rms(measured - model) / rms(measured), where the noise is not known.
    chi2 : by how much that of the fitted records fell with what was added.
    """

    before: float | None
    after: float | None
    held_out: bool
    relative: bool = False
    chi2: float | None = None

    @property
    def where(self) -> str:
        """On which records."""
        return _HELD if self.held_out else "on the fitted records"

    @property
    def what(self) -> str:
        """The error's name."""
        return "relative error" if self.relative else "error"


def effect_words(name: str) -> str:
    """An effect's name in words: "pickoff_pole" is "pick-off pole"."""
    return " ".join(_WORDS.get(word, word) for word in name.split("_"))


def sentence(text: str) -> str:
    """With a capital at its head; all else as it is (``capitalize`` would make "Adc" of "ADC")."""
    return text[:1].upper() + text[1:]


def listed(names: Sequence[str], last: str = "and") -> str:
    """ "a, b and c" """
    return f"{', '.join(names[:-1])} {last} {names[-1]}" if len(names) > 1 else "".join(names)


def error_words(value: float | None, relative: bool = False) -> str:
    """An error with the digits that matter: two decimals near the noise, three figures far above it."""
    if value is None or not math.isfinite(value):
        return "–"
    if relative:
        return percent(value) if value >= 0.001 else f"{100.0 * value:.2g}{PERCENT}"
    return (
        f"{value:,.0f}".replace(",", "\u202f")
        if value >= 1000.0
        else f"{value:.3g}"
        if value >= 10.0
        else f"{value:.2f}"
    )


def missing_sentence(
    verdict: str, effects: Sequence[str], classes: Sequence[Sequence[str]], added: bool, tried: Sequence[str] = ()
) -> str:
    """What was missing, in one sentence.

    Parameters
    ----------
    verdict : of the last rung, of the diagnosis, or "" where only a comparison was made.
    effects : added or named.
    classes : members that these records cannot tell apart.
    added : the effects are in the last model ("was"), not only named ("is").
    tried : rungs climbed although a misfit is left.
    """
    was = "was" if added else "is"
    if verdict == "fit_failed":
        return "The model could not be fitted, so nothing can be said about what is missing."
    if verdict == "unknown":
        part = [effect_words(name) for name in effects or tried]
        how = "together" if len(part) > 1 else "alone"
        also = f" {sentence(listed(part))} {how} cannot account for it." if part else ""
        return f"Something is missing that no effect of the library explains.{also}"
    if not effects:
        if verdict == "class" and classes:
            return f"What {was} missing: {_one_of(classes[0])}."
        if verdict == "adequate":
            return "Nothing is missing: these records show no effect beyond the model."
        return "How well the model explains these records."
    words = [_with_class(name, classes, alone=len(effects) == 1) for name in effects]
    return f"What {was} missing: {listed(words)}."


def _with_class(name: str, classes: Sequence[Sequence[str]], alone: bool) -> str:
    """An effect and those that could stand in its place; in brackets where other effects are listed beside it."""
    others = [one for members in classes if name in members for one in members if one != name]
    if not others:
        return effect_words(name)
    return _one_of([name, *others]) if alone else f"{effect_words(name)} (or {_one_of(others)})"


def _one_of(members: Sequence[str]) -> str:
    return listed([effect_words(name) for name in members], "or")


def fall_sentence(fall: Fall, verdict: str) -> str:
    """How far the error fell, or where it stands; empty where it is not known."""
    before, after = error_words(fall.before, fall.relative), error_words(fall.after, fall.relative)
    if fall.before is not None and fall.after is not None:
        if before == after and fall.chi2 is not None and fall.chi2 > 0.0:
            weak = f"χ² of the fitted records fell by {fall.chi2:,.0f}".replace(",", "\u202f")
            return f"The {fall.what} stays at {after} {fall.where}: beside the noise this is weak; {weak}."
        if before == after:
            return f"The {fall.what} stays at {after} {fall.where}."
        if fall.after > fall.before:
            return f"The {fall.what} went from {before} to {after} {fall.where}."
        return f"The {fall.what} fell from {before} to {after} {fall.where}."
    if fall.before is None and fall.after is None:
        return ""
    value = after if fall.after is not None else before
    if fall.relative:
        return f"The {fall.what} is {value} {fall.where}."
    if verdict in ("", "effect", "class", "unknown", "fit_failed"):
        return f"The {fall.what} is {value} {fall.where}; 1.00 would be the noise alone."
    return f"The {fall.what} is {value} {fall.where}: the noise alone gives 1.00."


def standing_notes(
    verdict: str,
    classes: Sequence[Sequence[str]],
    statuses: Mapping[str, str],
    wrong_form: Mapping[str, str],
    left: str,
    why: str,
    separating: str | None,
    held_out: bool,
) -> tuple[str, ...]:
    """What the reader must know beside the two sentences of the head.

    ``separating`` is the record that would separate the classes, "" or ``NONE`` and why where there is none, ``None`` where
    nobody asked.
    """
    notes = []
    for members in classes:
        if len(members) > 1:
            how = f" A record that would: {separating}." if separating else ""
            if separating is not None and (not separating or separating.startswith(NONE)):
                how = f" No record of this instrument would{separating.removeprefix(NONE)}."
            notes.append(f"These records cannot tell {listed([effect_words(one) for one in members])} apart.{how}")
    for name, by in wrong_form.items():
        notes.append(
            f"Right place, wrong form: the size of {effect_words(name)} disagrees"
            + (f" between {_parts(by)}." if by else ".")
        )
    doubted = [
        effect_words(name) for name, status in statuses.items() if status == "partial" and name not in wrong_form
    ]
    if doubted and verdict != "unknown":
        are = "are" if len(doubted) > 1 else "is"
        but = "not confirmed by the held-out ones" if held_out else "no record was held out"
        notes.append(f"Partial: {listed(doubted)} {are} significant on the fitted records, but {but}.")
    if verdict == "unknown" and left:
        notes.append(f"What is left: {left_words(left)}.")
    if verdict == "fit_failed" and why:
        notes.append(f"Why: {why}.")
    return tuple(notes)


def left_words(left: str) -> str:
    """The strongest structure that is left, "test: where", in words."""
    test, _, where = left.partition(": ")
    if test == "agreement":
        what, _, partition = where.rpartition(" by ")
        return f"{effect_words(what)} as fitted disagree between {_parts(partition)}"
    if test == "repeat":
        return f"what repeats of a drive have in common and the model has not ({where})"
    if test == "probe":
        return f"something that follows the response itself ({where})"
    return f"more than noise in {where}" if test == "region" else left


def _parts(partition: str) -> str:
    return {"block": "records", "level": "drive levels", "direction": "sweep directions"}.get(
        partition, f"{partition}s"
    )


_GREEK = {
    "psi": "ψ", "omega": "ω", "Omega": "Ω", "zeta": "ζ", "theta": "θ", "gamma": "γ", "beta": "β", "tau": "τ", "eps": "ε",
    "phi": "φ", "alpha": "α", "delta": "δ", "pi": "π",
}  # fmt: skip


def typeset(text: str) -> str:
    """Plain mathematics with the letters and powers of print: "psi'' -= k3 |psi|^2 psi" is "ψ″ −= k3 |ψ|² ψ"."""
    text = re.sub(r"(?<![A-Za-z])(" + "|".join(_GREEK) + r")(?![A-Za-z])", lambda m: _GREEK[m[1]], text)
    text = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(SUPERSCRIPT), text)
    return text.replace("''", "″").replace("'", "′").replace(" -= ", " −= ").replace(" - ", " − ")


def explained_words(share: float | None) -> str:
    """A share of a misfit that was explained; never rounded up to all of it."""
    if share is None:
        return "–"
    if 0.9999 <= share < 1.0:
        return f"> 99.99{PERCENT}"
    return percent(share).replace("-", "−")


#: Kinds of region that cut the plane of time and frequency: their shares add up to one together.
FREQUENCY_KINDS = ("resonance", "harmonic", "line", "broadband")
_NOT_A_PLACE = ("family", "kind", "share", "error", "error_after", "explained", "p_value")


def family_words(family: str) -> str:
    """A family of regions, as in "By ..."."""
    return {
        "level": "level of the drive",
        "response": "level of the motion",
        "direction": "direction of the sweep",
    }.get(family, family.replace("_", " "))


def kind_words(kind: str, order: Any = None) -> str:
    """A kind of region, with the order of a harmonic."""
    if kind == "harmonic" and isinstance(order, int):
        return "the drive's own frequency" if order == 1 else f"{_ordinal(order)} harmonic of the drive"
    return {
        "line": "fixed line",
        "broadband": "between the resonances and beyond",
        "harmonic": "harmonic of the drive",
    }.get(kind, kind.replace("_", " "))


def _ordinal(order: int) -> str:
    return f"{order}" + {2: "nd", 3: "rd"}.get(order, "th")


def quantity_words(text: str) -> str:
    """A comma-separated list of failed limits in words; any other text as it is."""
    names = text.split(",")
    return listed([label(name) for name in names]) if all(name in LIMITED for name in names) else text


def p_words(p_value: float | None) -> str:
    """A p-value; the power of ten where it is small, and its order alone where it is tiny."""
    if p_value is None:
        return "–"
    if p_value < 1e-99:
        return "< 10⁻⁹⁹"
    if p_value < 1e-3:
        exponent = math.floor(math.log10(p_value))
        return f"{p_value / 10.0**exponent:.0f}·10{str(exponent).translate(SUPERSCRIPT)}"
    return f"{p_value:.2g}"


def region_words(region: Mapping[str, Any]) -> str:
    """Where a region lies: what it is, band, time, record, channel, and whatever else labels it."""
    kind = str(region.get("kind") or "")
    parts = [kind_words(kind, region.get("harmonic"))] if kind in FREQUENCY_KINDS else []
    for key in dict.fromkeys(("band_hz", "time_s", "record", "channel", *region)):
        value = region.get(key)
        if value is None or key in _NOT_A_PLACE or (key == "harmonic" and kind == "harmonic"):
            continue
        span = _span(value)
        if key == "band_hz":
            parts.append(_hertz(value) if kind == "line" else f"{span} Hz")
        elif key == "time_s":
            parts.append(f"{span} s")
        elif key == "channel":
            parts.append(f"sense {str(value).removeprefix('sense').strip()}")
        elif key in ("record", "direction"):
            parts.append(str(value))
        elif key == "response_v":
            parts.append(f"{span} V rms")
        elif key == "level":
            parts.append("the largest level" if value == 1.0 else f"{span} of the largest level")
        elif key.endswith(("_hz", "_s", "_v")):
            stem, _, unit = key.rpartition("_")
            parts.append(f"{stem.replace('_', ' ')} {span} {unit.replace('hz', 'Hz').replace('v', 'V')}")
        else:
            parts.append(f"{key.replace('_', ' ')} {span}")
    return ", ".join(parts) or "everywhere"


def _span(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " to ".join(_span(end) for end in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _hertz(band: Any) -> str:
    """The middle of a narrow band."""
    ends = list(band) if isinstance(band, Sequence) and not isinstance(band, str) else [band]
    numbers = [end for end in ends if isinstance(end, int | float)]
    return f"{sum(numbers) / len(numbers):.6g} Hz" if numbers else f"{_span(band)} Hz"


def noise_sentence(noise: Mapping[str, Any]) -> str:
    """The noise level by channel, and where it comes from."""
    sigma = noise.get("sigma")
    given = list(sigma) if isinstance(sigma, Sequence) and not isinstance(sigma, str) else []
    words = ", ".join(
        f"{1e3 * one:#.3g}".rstrip(".")
        for one in given
        if isinstance(one, int | float) and math.isfinite(one) and one > 0.0
    )
    whence = str(noise.get("from") or "")
    if not words:
        return "The noise level is not known, so only relative errors can be given."
    if whence == "residual":
        return (
            f"Nothing shows the noise by itself (no silence, no repeats): a smooth local fit leaves σ = {words} mV by "
            "channel, so only relative errors can be given."
        )
    source = {"silent": "the silent record", "repeats": "what repeats of a drive differ by (no silent record)"}
    return f"σ = {words} mV by channel" + (f", from {source.get(whence, whence)}." if whence else ".")
