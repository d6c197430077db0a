"""The pages of the effects, from what each effect declares about itself."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

from pipeline.device.effect import Effect, find_effects
from pipeline.device.parameters import Parameter

from .markdown import NOTE, block, code, number, plain, table
from .pictures import signature_picture
from .signatures import SIGMA_V, SNR, EffectSignature, alike, effect_signature

#: |cosine| of two signatures from which on the index lists the pair.
_ALIKE = 0.9
#: Columns of a block of code on a page.
_COLUMNS = 76
_STAGES = {
    "drive": "drive: volts to forces",
    "mechanics": "mechanics: linear, time-invariant",
    "force": "force: nonlinear or time-varying, integrated",
    "sense": "sense: motion to volts",
    "readout": "read-out: linear filter",
    "adc": "ADC: the samples",
    "disturbance": "disturbance: lines with free amplitudes",
}
_PLANTS = {
    "gyro": "gyro",
    "updown": "gyro with the up-down mode",
    "modal": "modal",
    "resonator": "modal with one drive and one sense",
}
_PER = {
    "axis": "one per axis",
    "drive": "one per drive",
    "path": "one per sense and drive",
    "direction": "one per sense but the first",
}
_ABOUT = """\
# Effects

An effect is one term in the physics of a device or of its read-out. `gyroscreen model add NAME model.toml` adds one to a
model; `diagnose` and `refine` look for them. At its null value an effect does exactly nothing.

In the equations $\\psi = (\\psi_x, \\psi_y)$ is the rocking motion and $z$ the up-down motion, both mass-normalised and in V s.
$v$ are the drive samples, $x$ is the motion at an electrode, and $S$ are the volts of the pick-offs before the filter. Dots stand
for the terms of the plant. `docs/how-to/add-an-effect.md` shows how to
write an effect of your own.
"""
_ALIKE_ABOUT = """\
## Which effects look alike?

`diagnose` puts effects that a campaign cannot tell apart into one class and names the record that would separate them. Two
lists say in advance which effects these are.

The first list is declared by the effects and tested: near the size named there, the effects on the right together reproduce
what the effect does to the standard campaign.
"""
_COSINE_ABOUT = """\
The second list is computed when this manual is built, from the pictures of the pages: |cosine| is the correlation between
what the two effects leave in one chirp after a fit of the plant. 1 means that this one chirp cannot tell them apart. Other
drive levels, other drive directions, or a silent record often can.
"""


def effect_pages() -> Mapping[str, str]:
    """Path below docs/reference/ -> page or picture of each effect of the library, and their index."""
    library = find_effects()
    found = {name: effect_signature(effect) for name, effect in library.items()}
    pages = {f"effects/{name}.md": _page(effect, found[name], library) for name, effect in library.items()}
    pictures = {f"effects/{name}.svg": signature_picture(one) for name, one in found.items()}
    return {"effects/index.md": _index(library, found), **pages, **pictures}


def _index(library: Mapping[str, Effect], found: Mapping[str, EffectSignature]) -> str:
    listed = [(f"[`{name}`]({name}.md)", plain(one.signature)) for name, one in library.items()]
    declared = [
        (
            f"[`{name}`]({name}.md)",
            " with ".join(map(code, like.effects)),
            "at every size" if like.always else "near an example",
        )
        for name, one in library.items()
        for like in one.look_alikes
    ]
    pairs = [(first, other, alike(found[first], found[other])) for first in found for other in found if first < other]
    close = sorted((pair for pair in pairs if pair[2] >= _ALIKE), key=lambda pair: -pair[2])
    parts = [
        NOTE,
        _ABOUT,
        table(("effect", "how records show it"), listed),
        _ALIKE_ABOUT,
        table(("effect", "looks like", "where"), declared),
        _COSINE_ABOUT,
        table(("effect", "other effect", "|cosine|"), [(code(a), code(b), f"{value:.3f}") for a, b, value in close]),
        "```{toctree}\n:hidden:\n\n" + "\n".join(library) + "\n```\n",
    ]
    return "\n".join(parts)


def _page(effect: Effect, found: EffectSignature, library: Mapping[str, Effect]) -> str:
    parts = [
        NOTE,
        f"# {effect.name}\n",
        f"{plain(effect.signature[:1].upper() + effect.signature[1:])}.\n",
        "## Equation\n",
        f"$$\n{effect.latex}\n$$\n\nIn plain text, as `gyroscreen effects {effect.name}` prints it:\n"
        if effect.latex
        else "",
        block(_lines(effect.law)),
        f"Source: {plain(effect.source)}.\n",
        "## Parameters\n",
        table(
            ("parameter", "meaning", "unit", "null", "range", "prior"),
            [_parameter(effect, one) for one in effect.parameters],
        ),
        "## Signature\n",
        f"![Spectra and rms over time of a record, of its change by {effect.name}, and of what a fit of the plant leaves]"
        f"({effect.name}.svg)\n",
        _caption(effect, found),
        "## Properties\n",
        table(("property", "value"), _properties(effect)),
        _look_alikes(effect, library),
    ]
    return "\n".join(parts)


def _lines(law: str) -> str:
    """A law with its clauses on lines of their own, none longer than the page is wide."""
    clauses = law.replace(",  ", ",\n").replace(";  ", ";\n").splitlines()
    return "\n".join(line for clause in clauses for line in textwrap.wrap(clause, _COLUMNS))


def _parameter(effect: Effect, one: Parameter) -> tuple[str, ...]:
    name = one.quantity or f"{effect.name}.{one.name}"
    family = f"; {_PER[one.per]}" if one.per else ""
    scanned = f"; scanned over {len(one.grid)} values" if one.grid else ""
    fixed = "; not fitted" if not one.fitted else ""
    limits = f"{number(one.low)} to {number(one.high)}"
    unit = "" if one.unit == "1" else plain(one.unit)
    meaning = plain(one.meaning + family + scanned + fixed)
    return code(name), meaning, unit, number(one.null), limits, plain(one.prior)


def _caption(effect: Effect, found: EffectSignature) -> str:
    sizes = ", ".join(f"{code(name)} = {_rounded(float(value), 3)}" for name, value in found.sizes.items())
    chirp = f"The record is a chirp of 1 s on a device like that of the paper, with {sizes}"
    if effect.disturbance is not None:
        return f"{chirp} and lines of 1 mV.\n"
    snr = float((found.change**2).sum() ** 0.5) / SIGMA_V
    wanted = "" if abs(snr / SNR - 1.0) < 0.1 else f" Clipping sets in at once, so no size comes closer to {SNR:g}."
    return (
        f"{chirp}. The norm of its change over both channels is {_rounded(snr, 2)} times the noise of 1 mV.{wanted}\n"
    )


def _rounded(value: float, digits: int) -> str:
    return number(float(f"{value:.{digits}g}"))


def _properties(effect: Effect) -> list[tuple[str, str]]:
    rows = [
        ("stages", "; ".join(_STAGES[stage] for stage in effect.stages)),
        ("plants", "; ".join(_PLANTS[plant] for plant in effect.plants)),
    ]
    rows += (
        [("a declared condition fixes it", plain(f"{effect.condition}_dps of the record"))] if effect.condition else []
    )
    rows += (
        [("records", "only demodulated records (sweeps of a lock-in amplifier) have it as a candidate")]
        if effect.demodulated
        else []
    )
    rows += (
        [("bias", "its law contains the bias: records at another bias help to identify it")]
        if effect.depends_on_bias
        else []
    )
    rows += [("hold", "a wrongly declared hold of the drive samples looks like it")] if effect.mimics_hold else []
    rows += [("modes", "adds a mode; a model may hold it several times")] if effect.resonance else []
    rows += [("memory", f"{effect.memories} internal state per axis")] if effect.memories else []
    return rows


def _look_alikes(effect: Effect, library: Mapping[str, Effect]) -> str:
    own = [
        (" with ".join(f"[{code(name)}]({name}.md)" for name in like.effects), _where(like.always, like.example))
        for like in effect.look_alikes
    ]
    others = [
        (f"[{code(name)}]({name}.md)", f"{name} looks like this effect: {_where(like.always, like.example)}")
        for name, one in library.items()
        for like in one.look_alikes
        if effect.name in like.effects and name != effect.name
    ]
    if not own and not others:
        return "## Look-alikes\n\nNo other effect of the library is declared to reproduce its records.\n"
    return f"## Look-alikes\n\n{table(('effects', 'where'), [(a, plain(b)) for a, b in (*own, *others)])}"


def _where(always: bool, example: Mapping[str, float]) -> str:
    return (
        "at every size"
        if always
        else "near " + ", ".join(f"{name} = {number(value)}" for name, value in example.items())
    )
