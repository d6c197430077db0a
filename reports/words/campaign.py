"""Sentences about verdicts, errors, noise and places for the pages and terminal texts of the learning loop.  No HTML.

One function states one fact.  Campaigns and modal records share them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.learning.answers import DiagnosisAnswer, Noise, RefinementAnswer
from pipeline.quantities import NAMES

from .numbers import volts
from .quantities import error_words, grouped, label, listed, partition_words, percent
from .records import record_sentences

FIRST_MODEL = "first model"
UNCONVERGED = "The fit did not converge, or the records do not determine every parameter."
#: How the text of a separating record begins where no such record exists.
NO_RECORD = "none with this instrument"
_SPELLED = {"offdiagonal": "off-diagonal", "updown": "up-down", "pickoff": "pick-off", "adc": "ADC"}


@dataclass(frozen=True)
class ErrorChange:
    """The error of the first and of the last model.

    Parameters
    ----------
    before, after : [sigma], or relative errors; ``None`` where not known.
    where : the data, as in "on the held-out records".
    relative : rms(measured - model)/rms(measured), used where the noise level is not known.
    delta_chi2 : total decrease of chi2 on the fitted records.
    """

    before: float | None
    after: float | None
    where: str
    relative: bool = False
    delta_chi2: float | None = None

    @property
    def known(self) -> bool:
        """Whether there is an error at all."""
        return self.before is not None or self.after is not None

    @property
    def misfit(self) -> tuple[float | None, float | None]:
        """sqrt(max(error^2 - 1, 0)) of both [sigma]; ``None`` where the error is not known."""
        ends = (None if one is None else math.sqrt(max(one * one - 1.0, 0.0)) for one in (self.before, self.after))
        return next(ends), next(ends)

    @property
    def name(self) -> str:
        """ "error" or "relative error"."""
        return "relative error" if self.relative else "error"


def effect_words(name: str) -> str:
    """Name of an effect in words: "pickoff_pole" is "pick-off pole", and "internal_resonance_1_2" is "internal resonance 1:2"."""
    name = re.sub(r"_(\d)_(\d)$", r" \1:\2", name)
    return re.sub(rf"\b({'|'.join(_SPELLED)})\b", lambda match: _SPELLED[match[0]], name.replace("_", " "))


def sentence(text: str) -> str:
    """``text`` with a capital first letter; the rest is unchanged (``capitalize`` would turn "ADC" into "Adc")."""
    return text[:1].upper() + text[1:]


def effects_listed(names: Sequence[str], last: str = "and") -> str:
    """Several effects in words."""
    return listed([effect_words(name) for name in names], last)


def rung_name(effect: str | None) -> str:
    """Name of a model of the ladder by the effect that it adds."""
    return f"+ {effect_words(effect)}" if effect else FIRST_MODEL


def parameter_words(name: str) -> str:
    """A parameter in words: "cubic_stiffness.k3" is "cubic stiffness: k3"."""
    effect, dot, symbol = name.rpartition(".")
    return f"{effect_words(effect)}: {symbol}" if dot else label(name)


def missing_sentence(
    verdict: str,
    effects: Sequence[str],
    classes: Sequence[Sequence[str]],
    *,
    added: bool,
    tried: Sequence[str] = (),
    imitating: Sequence[str] = (),
    noise_known: bool = True,
    louder: float | None = None,
    data: str = "records",
) -> str:
    """The verdict in one or two sentences.

    Parameters
    ----------
    verdict : of the last rung or of the diagnosis; "" where the model was only compared.
    effects, classes : the named effects, and the sets of effects that the data cannot distinguish.
    added : whether the effects are in the last model.
    tried : effects of the ladder, named where a misfit remains.
    imitating : effects that remove the misfit together, though one of them is not supported by itself.
    noise_known : false where only relative errors are known.
    louder : how many times as loud as measured the noise of the driven records is, where that is so.
    data : "records" or "residues".
    """
    is_ = "was" if added else "is"
    noise = f" The noise of the driven records is {louder:.3g} times as loud as measured." if louder else ""
    if verdict == "fit_failed" and (effects or tried):
        return "A misfit remains, and the fit of an effect that may explain it did not succeed."
    if verdict == "fit_failed":
        return "The model could not be fitted, so nothing can be said about missing effects."
    if verdict == "unknown" and imitating:
        return (
            f"The missing effect could not be named: {effects_listed(imitating)} remove the misfit together, but at least one "
            "of them has no support of its own. Together they may imitate an effect that the library lacks."
        )
    if verdict == "unknown":
        names = list(effects or tried)
        but = f" {sentence(effects_listed(names))} {'do' if len(names) > 1 else 'does'} not remove it." if names else ""
        return f"A misfit remains that no effect in the library explains.{but}"
    if effects:
        alone = len(effects) == 1
        return f"What {is_} missing: {listed([_with_rivals(name, classes, alone) for name in effects])}.{noise}"
    if verdict == "class" and classes:
        return f"What {is_} missing: {effects_listed(classes[0], 'or')}."
    if verdict == "adequate" and noise:
        return f"Nothing is missing.{noise}"
    if verdict == "adequate" and noise_known:
        return f"Nothing is missing: the model explains these {data} down to the noise."
    if verdict == "adequate":
        return "No effect in the library is significant. The noise level is unknown, so a small misfit may remain."
    return f"How well the model explains these {data}."


def _with_rivals(name: str, classes: Sequence[Sequence[str]], alone: bool) -> str:
    """An effect and the other members of its class, in brackets where it stands in a list."""
    others = [one for members in classes if name in members for one in members if one != name]
    if others and not alone:
        return f"{effect_words(name)} (or {effects_listed(others, 'or')})"
    return effects_listed([name, *others], "or")


def change_sentence(change: ErrorChange) -> str:
    """How the error changed from the first to the last model, or what it is; "" where it is not known."""
    if not change.known:
        return ""
    before, after = error_words(change.before, change.relative), error_words(change.after, change.relative)
    if change.before is None or change.after is None:
        value = after if change.before is None else before
        floor = "" if change.relative else "; 1.00 is the noise floor"
        return f"The {change.name} is {value} {change.where}{floor}."
    if before != after:
        moved = "rose" if change.after > change.before else "fell"
        return f"The {change.name} {moved} from {before} to {after} {change.where}."
    weak = ""
    if change.delta_chi2 is not None and change.delta_chi2 > 0.0:
        weak = f": the effect is small beside the noise. χ² on the fitted records fell by {grouped(change.delta_chi2)}"
    return f"The {change.name} stays at {after} {change.where}{weak}."


def largest_place_sentence(place: str, share: float, model: str) -> str:
    """Where the largest part, ``share`` (0 to 1), of the misfit of a model ("model" or "first model") lies."""
    return f"Largest part of the misfit of the {model}: {place} ({percent(share)})."


def class_sentence(members: Sequence[str]) -> str:
    """The effects that the data cannot distinguish."""
    return f"These data cannot distinguish {effects_listed(members, 'from' if len(members) == 2 else 'and')}."


def separating_sentence(record: str | None) -> str:
    """The record that would separate a class; ``None`` where it was not searched for."""
    if not record:
        return ""
    if record.startswith(NO_RECORD):
        return f"No record that this instrument can take would separate them{record.removeprefix(NO_RECORD)}."
    return f"This record would separate them: {record}."


def failure_sentence(why: str) -> str:
    """Why a fit failed."""
    return f"The fit failed: {why.rstrip('.') or 'no reason was given'}."


def wrong_form_sentence(name: str, by: str) -> str:
    """An effect whose fitted size is not the same in all records; ``by`` is the partition of the records."""
    return f"The fitted size of {effect_words(name)} differs between {partition_words(by)}: its law may have the wrong form."


def partial_sentence(names: Sequence[str], held_out: bool) -> str:
    """Effects that are significant on the fitted records but not confirmed."""
    are = "are" if len(names) > 1 else "is"
    them = "them" if len(names) > 1 else "it"
    but = f"the held-out records do not confirm {them}" if held_out else f"no record was held out to confirm {them}"
    return f"Partial: {effects_listed(names)} {are} significant on the fitted records, but {but}."


def not_tried_sentence(rungs: int, names: Sequence[str]) -> str:
    """Why a ladder with this number of added effects went no further, which effects it did not try, and how to go on."""
    were = "s were" if len(names) > 1 else " was"
    return (
        f"The ladder ends after {rungs} effects, because more would only imitate something that the library lacks. "
        f"The following significant effect{were} not tried: {effects_listed(names)}. To go on, add the effects that were found "
        "to a model file (gyroscreen model add EFFECT MODEL.toml) and refine that model (gyroscreen refine --model MODEL.toml)."
    )


def modal_partial_sentence(noise_known: bool) -> str:
    """Why no effect of a modal record is confirmed."""
    noise = "" if noise_known else " The misfit that remains serves as the noise level."
    return f"Every effect is partial: a modal record has no held-out data.{noise}"


def remaining_words(left: str) -> str:
    """The strongest structure that the last model leaves; ``left`` is "test: where"."""
    test, _, where = left.partition(": ")
    if test == "agreement":
        name, _, partition = where.rpartition(" by ")
        return f"the fitted size of {effect_words(name)} differs between {partition_words(partition)}"
    frames = {
        "repeat": "a repeatable residual ({})",
        "probe": "a residual that correlates with the response ({})",
        "region": "a residual above the noise in {}",
        "line": "an unmodelled {}",
    }
    return frames[test].format(where) if test in frames else left


def notes(answer: DiagnosisAnswer | RefinementAnswer) -> list[str]:
    """What a reader must know beside the headline: failure, classes, forms, partial effects, what remains, hints."""
    ladder = answer.ladder if isinstance(answer, RefinementAnswer) else ()
    found = [failure_sentence(answer.why)] if answer.verdict == "fit_failed" else []
    found += [class_sentence(members) for members in answer.classes if len(members) > 1]
    if answer.separating_record:
        found.append(separating_sentence(answer.separating_record))
    found += [wrong_form_sentence(name, how.by) for name, how in answer.wrong_form.items()]
    named = [one.effect for one in ladder if one.effect and one.status == "partial"]
    partial = [name for name in named if name not in answer.wrong_form]
    if any(rung.dof for rung in ladder[1:]):
        found.append(modal_partial_sentence(ladder[0].error_fit is not None))
    elif partial and answer.verdict != "unknown":
        found.append(partial_sentence(partial, any(rung.error_validate is not None for rung in ladder)))
    if answer.verdict == "unknown" and answer.left and not answer.imitating:
        found.append(f"Remaining structure: {remaining_words(answer.left)}.")
    if isinstance(answer, RefinementAnswer) and answer.not_tried:
        found.append(not_tried_sentence(len(ladder) - 1, answer.not_tried))
    return [*found, *record_sentences(answer), *(answer.hints or ())]


def reason_words(text: str) -> str:
    """A comma-separated list of failed limits in words; any other text is unchanged."""
    names = text.split(",")
    return listed([label(name) for name in names]) if all(name in NAMES for name in names) else text


def noise_sentence(noise: Noise | None) -> str:
    """The noise level sigma by channel (by mode for a modal record), and how it was determined."""
    if noise is not None and noise.parts:
        each = (f"{name} {volts(own)}" for name, own in noise.parts.items())
        return f"Each part of the campaign has a noise level of its own: {'; '.join(each)}."
    if noise is None or not any(math.isfinite(one) and one > 0.0 for one in noise.sigma):
        return "The noise level is not known, so only relative errors can be given."
    if noise.unit:
        sigma = listed(list(dict.fromkeys(percent(one) for one in noise.sigma)))
        if noise.from_ == "declared":
            return f"The record declares a noise level of {sigma} of the {noise.unit}."
        return (
            "The noise level could not be measured, so only relative errors are given. "
            f"The misfit of the fit, {sigma} of the {noise.unit}, serves as the noise level in F-tests."
        )
    sigma = f"σ = {volts(noise.sigma)} by channel"
    if noise.local_fit:
        return (
            f"{sigma}, from a smooth local fit of the response away from the resonances (no silent record, no repeats). "
            "It judges the models, but only relative errors are given."
        )
    if noise.from_ == "residual":
        return (
            "The noise level could not be measured (no silent record, no repeats), so only relative errors are given. "
            f"A smooth local fit leaves {sigma}."
        )
    sources = {
        "silent": "measured on the silent record",
        "repeats": "from the differences between repeats of a drive (there is no silent record)",
    }
    kind, dependent = "; its spectrum is not white" if noise.coloured else "", ""
    if noise.jitter_s:
        dependent = f" The sampling instants jitter by {1e6 * noise.jitter_s:.2g} µs rms."
    elif noise.gain_noise:
        dependent = f" The gain varies by {1e6 * noise.gain_noise:.2g} ppm rms from sample to sample."
    return f"{sigma}, {sources.get(noise.from_, noise.from_)}{kind}.{dependent}"
