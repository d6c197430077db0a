"""The pages of the irregularities, from what each declares about itself."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping

import msgspec

from pipeline.learning.lot.generic import GenericIrregularity, generic_irregularities
from populations.describe import law_of, levels_of, values_of
from populations.draw import draw
from populations.irregularity import Irregularity, IrregularityParameter, find
from populations.spec import PopulationSpec, load_spec

from .laws import law_as_latex
from .markdown import NOTE, block, code, number, plain, table
from .patterns import generic_pattern, parts_alike, population_pattern
from .pictures import pattern_picture

_ABOUT = """\
# Irregularities

An irregularity is a change that fabrication or packaging makes to a device. A population states which irregularities it has
and how large they are; {doc}`../files/population` lists the other keys of its file. The generic irregularities need no
physics: `refine` looks for their patterns in any measured lot. `docs/how-to/add-an-irregularity.md` shows how to write one
of your own.

## Irregularities of a population
"""
_GENERIC_SYMBOLS = r"""$\Delta q$ is the change of a quantity $q$ of the lot. $s$ and $b$ are free sizes. $n$ is a standard
normal number; its index names the unit whose devices share it. $\rho$ and $\varphi$ are the polar coordinates of a die,
$\rho$ in wafer radii.
"""
_GENERIC_ABOUT = f"## Generic irregularities\n\n{_GENERIC_SYMBOLS}"
_ALIKE_ABOUT = """\
## Which irregularities look alike?

A random part of an irregularity has a level: the devices of a lot, wafer or die share its numbers. Parts on one line have the
same level and changes in the same proportion, so no measured lot can tell them apart; `refine` names them together.
"""
#: What a change means on a page; the symbols are those of the equations.
CHANGED = {
    "ln_stiffness": "the stiffness of all springs, $\\ln k$",
    "ln_spring": "the stiffness of each spring, $\\ln k_j$",
    "azimuth_rad": "the azimuth of each spring",
    "anisotropy": "the anisotropy $e$ of the stiffness, "
    r"$K = K_0 \left( 1 + \begin{pmatrix} \text{Re}\,e & \text{Im}\,e \\ \text{Im}\,e & -\text{Re}\,e \end{pmatrix} \right)$",
    "post_offset_mm": "the offset $d$ of the post from the centre",
    "ln_area": "the area of each electrode, $\\ln A_k$",
    "ln_gap": "the gap of each electrode, $\\ln g_k$",
    "ln_arm": "the arm of each electrode, $\\ln l_k$",
    "ln_channel": "the gain of each channel of the prober, $\\ln K_k$",
    "ln_pressure": "the pressure around the device, $\\ln p$",
    "ln_gas": "the gas damping of rocking and of up-down motion at a given pressure",
    "ln_anchor": "the anchor loss",
    "damping_anisotropy": "the anisotropy $d$ of the damping",
}
_STAGES = {
    "fabrication": "fabrication (always present)",
    "probe": "probe (only in the wafer prober)",
    "package": "package (only in the package)",
}
_NEEDS = {
    "lots": "two lots or more",
    "wafers": "two wafers or more",
    "places": "positions of the dies",
    "time": "times of the measurements",
    "testers": "two testers or more",
    "quantities": "two quantities or more",
}


def irregularity_pages() -> Mapping[str, str]:
    """Path below docs/reference/ -> page or picture of each irregularity, and their index."""
    spec = load_spec()
    known, generic, levels = find(), generic_irregularities(), levels_of(spec)
    changes = _changes(known, spec)
    alike = parts_alike(spec)
    pages = {"index.md": _index(known, generic, alike)}
    for name, one in known.items():
        pages[f"{name}.md"] = _page(one, spec, levels[name], changes[name], alike)
        if name in spec.irregularity:
            pages[f"{name}.svg"] = pattern_picture(population_pattern(one, spec))
    for name, shape in generic.items():
        pages[f"generic-{name}.md"] = _generic_page(shape)
        pages[f"generic-{name}.svg"] = pattern_picture(generic_pattern(shape, spec))
    return {f"irregularities/{name}": text for name, text in pages.items()}


def _index(
    known: Mapping[str, Irregularity], generic: Mapping[str, GenericIrregularity], alike: tuple[tuple[str, ...], ...]
) -> str:
    own = [(f"[`{name}`]({name}.md)", one.stage, plain(law_of(one))) for name, one in known.items()]
    shapes = [(f"[`{name}`](generic-{name}.md)", *_sentence_and_law(one)) for name, one in generic.items()]
    names = "\n".join([*known, *(f"generic-{name}" for name in generic)])
    return "\n".join(
        [
            NOTE,
            _ABOUT,
            table(("irregularity", "stage", "what it is"), own),
            _ALIKE_ABOUT,
            "\n".join(f"- {', '.join(map(code, names))}" for names in alike),
            "",
            _GENERIC_ABOUT,
            table(("irregularity", "what it is", "law"), shapes),
            f"```{{toctree}}\n:hidden:\n\n{names}\n```\n",
        ]
    )


def _page(
    one: Irregularity,
    spec: PopulationSpec,
    levels: tuple[str, ...],
    changes: tuple[str, ...],
    alike: tuple[tuple[str, ...], ...],
) -> str:
    text = inspect.cleandoc(one.act.__globals__.get("__doc__") or one.name)
    summary, *rest = list(_paragraphs(text, laws=not one.latex))
    parameters = [_parameter(parameter, spec.irregularity.get(one.name, {})) for parameter in one.parameters]
    picture = []
    if one.name in spec.irregularity:
        where = "as the wafer prober measures it" if one.stage == "probe" else "of packaged devices"
        picture = [
            "## Picture\n",
            f"![Maps of four wafers and shares of the spreads by {one.name}]({one.name}.svg)\n",
            f"Population {code(spec.name)} drawn with and without it, with the same random numbers: the change {where}. "
            "The maps show the quantity with the largest share, on two wafers of each of two lots. A share above 100 % is "
            "possible, because other irregularities may cancel it.\n",
        ]
    varies = f"varies by {', '.join(levels)}" if levels else "has no random numbers"
    return "\n".join(
        [
            NOTE,
            f"# {one.name}\n",
            summary,
            "## Equation\n",
            f"$$\n{one.latex}\n$$\n" if one.latex else "",
            *rest,
            f"It changes {'; '.join(changes)}.\n",
            f"Stage: {_STAGES[one.stage]}. It {varies}.\n",
            "## Parameters\n",
            f"Keys of `[irregularity.{one.name}]` in a population file.\n",
            table(("key", "meaning", "unit", "null", "cloverleaf", "range"), parameters),
            *picture,
            "## Look-alikes\n",
            _look_alikes(one.name, alike),
        ]
    )


def _generic_page(one: GenericIrregularity) -> str:
    needs = ", ".join(_NEEDS[need] for need in one.needs) or "nothing beside the quantities"
    probe = (
        "A probe: it shows a misfit and is never named, because it says nothing about its cause.\n" if one.probe else ""
    )
    sentence, law = _sentence_and_law(one)
    return "\n".join(
        [
            NOTE,
            f"# {one.name} (generic)\n",
            f"{sentence}\n",
            f"## Equation\n\n{law.replace('$', '$$')}\n\n{_GENERIC_SYMBOLS}" if law else "",
            probe,
            f"A lot must have: {needs}.\n",
            "## Picture\n",
            f"![Maps of four wafers with {one.name}](generic-{one.name}.svg)\n",
            "One draw on two wafers of each of two lots; the testers alternate from wafer to wafer. The unit is "
            "the size `s` or `b`.\n",
        ]
    )


def _look_alikes(name: str, alike: tuple[tuple[str, ...], ...]) -> str:
    rows = [
        (code(part), ", ".join(code(other) for other in names if other != part))
        for names in alike
        for part in names
        if part.partition(".")[0] == name
    ]
    if not rows:
        return "No random part of it is proportional to one of another irregularity in packaged devices.\n"
    return f"No measured lot can tell these random parts apart.\n\n{table(('part', 'looks like'), rows)}"


def _parameter(one: IrregularityParameter, given: Mapping[str, float]) -> tuple[str, ...]:
    null = "must be stated" if one.null is None else number(one.null)
    unit = "" if one.unit == "1" else plain(one.unit)
    assumption = f"; named assumption {one.assumption}" if one.assumption else ""
    stated = number(given[one.name]) if one.name in given else ""
    return (
        code(one.name),
        plain(one.meaning + assumption),
        unit,
        null,
        stated,
        f"{number(one.low)} to {number(one.high)}",
    )


def _sentence_and_law(one: GenericIrregularity) -> tuple[str, str]:
    """What a generic irregularity is, and its law as a formula or nothing."""
    sentence, law = law_as_latex(_documented(one))
    return plain(sentence), f"${law}$" if law else ""


def _documented(one: GenericIrregularity) -> str:
    """The summary of the file that declares it."""
    module = next(m for m in list(sys.modules.values()) if getattr(m, "GENERIC", None) is one)
    return " ".join(inspect.cleandoc(module.__doc__ or one.meaning).split("\n\n")[0].split())


def _changes(known: Mapping[str, Irregularity], spec: PopulationSpec) -> Mapping[str, tuple[str, ...]]:
    """What each irregularity changes in a device, in the order of :class:`Change`."""
    every = {name: dict(values_of(one, spec)) for name, one in known.items()}
    drawn = draw(msgspec.structs.replace(spec, irregularity=every), 0, 0, 1)
    return {
        name: tuple(words for field, words in CHANGED.items() if getattr(change, field) is not None)
        for name, _, change in drawn.changes
    }


def _paragraphs(text: str, laws: bool) -> Iterator[str]:
    """The paragraphs of a docstring as Markdown; indented ones are equations in plain text, shown where ``laws`` is true."""
    for part in text.split("\n\n"):
        if not part.startswith("    "):
            yield f"{plain(' '.join(part.split()))}\n"
        elif laws:
            yield block(inspect.cleandoc(part))
