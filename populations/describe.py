"""A population as a commented TOML file: every key with its unit, range, default, meaning and source.

Everything comes from the library and from the tables of ``nominal``: a new irregularity appears by itself.  The levels between
which an irregularity varies are found by recording the random numbers that it reads.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any, get_args

import msgspec

from pipeline.errors import printable
from pipeline.toml_files import encoded, key, table
from pipeline.toml_keys import meanings

from .irregularity import Irregularity, IrregularityParameter, find
from .latent import latent_space
from .nominal import NominalDevice, Operating, Wafer
from .site import Level
from .spec import PopulationSpec, load_spec

_WIDTH = 118
_TABLES: Mapping[str, tuple[type[msgspec.Struct], str]] = {
    "device": (NominalDevice, "The device as designed.  The unit of a key is the end of its name."),
    "wafer": (Wafer, "The wafer, and how many wafers and lots are sampled in turn."),
    "operating": (Operating, "The operating point."),
}


def described(spec: PopulationSpec) -> str:
    """The complete population as commented TOML, which reads back to the same devices, bit for bit.

    Irregularities of the library that ``spec`` lacks are comments, with the values of the shipped population.
    """
    known, levels = find(spec.irregularity_folders), levels_of(spec)
    head = {"name": spec.name}
    if spec.irregularity_folders:
        head |= {"irregularity_folders": list(spec.irregularity_folders)}  # type: ignore[dict-item]
    parts = [
        _comment(f'Population "{spec.name}": all its keys, and all irregularities of the library.')
        + _comment(
            'In a run configuration: [source] spec = "FILE.toml".  A file may also state only what differs from another one:'
        )
        + _comment('extends = "NAME" or "FILE.toml", and without = ["IRREGULARITY"].')
        + table("", head),
        *(_table(name, getattr(spec, name)) for name in _TABLES),
        _comment(
            "Irregularities.  One without a table is not in the population, and one with its defaults changes nothing.  Spreads "
            "are standard deviations."
        ),
    ]
    for name in sorted(known):
        own = known[name]
        if name in spec.irregularity:
            parts.append(irregularity_table(own, values_of(own, spec), levels[name]))
        else:
            text = irregularity_table(own, values_of(own, load_spec()), levels[name])
            parts.append(_comment(f"Not in this population: {name}") + _commented(text))
    return "\n".join(parts)


def irregularity_table(irregularity: Irregularity, values: Mapping[str, float], levels: tuple[str, ...]) -> str:
    """The commented table of an irregularity with these values; ``levels`` as of :func:`levels_of`."""
    varies = f"varies by {', '.join(levels)}" if levels else "no random numbers"
    about = f"Stage {irregularity.stage}; {varies}.  Source: {irregularity.source}."
    lines = [(f"{key(one.name)} = {encoded(values[one.name])}", _about(one)) for one in irregularity.parameters]
    return (
        f"{_comment(law_of(irregularity))}{_comment(about)}[irregularity.{key(irregularity.name)}]\n{_aligned(lines)}"
    )


def levels_of(spec: PopulationSpec) -> Mapping[str, tuple[str, ...]]:
    """Name of each irregularity of the library -> the levels of the random numbers that it reads, from lot to package.

    "tester" stands for numbers that all devices share.
    """
    known = find(spec.irregularity_folders)
    every = {name: dict(values_of(one, spec)) for name, one in known.items()}
    streams = latent_space(msgspec.structs.replace(spec, irregularity=every))
    order = (*get_args(Level), "tester")
    read: dict[str, set[str]] = {name: set() for name in known}
    for stream in (*streams.size, *(f"{name}/tester/" for name in streams.fixed)):
        name, _, rest = stream.partition("/")
        if name in read:
            read[name].add(rest.partition("/")[0])
    return {name: tuple(level for level in order if level in levels) for name, levels in read.items()}


def values_of(irregularity: Irregularity, spec: PopulationSpec) -> Mapping[str, float]:
    """All values of an irregularity in ``spec``: stated, else null, else the low end of the range."""
    given = spec.irregularity.get(irregularity.name, {})
    null = {one.name: one.low if one.null is None else one.null for one in irregularity.parameters}
    return {name: given.get(name, value) for name, value in null.items()}


def law_of(irregularity: Irregularity) -> str:
    """The first paragraph of the file that defines the irregularity."""
    text: str = irregularity.act.__globals__.get("__doc__") or irregularity.name
    return " ".join(text.strip().partition("\n\n")[0].split())


def _table(name: str, values: msgspec.Struct) -> str:
    kind, about = _TABLES[name]
    known = meanings(kind)
    plain: dict[str, Any] = msgspec.to_builtins(values)
    return f"{_comment(about)}[{name}]\n{_aligned([(f'{k} = {encoded(v)}', known[k].text) for k, v in plain.items()])}"


def _about(parameter: IrregularityParameter) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    null = "must be stated" if parameter.null is None else f"default {parameter.null:g}"
    name = f"; named assumption {parameter.assumption}" if parameter.assumption else ""
    return f"{parameter.low:g} to {parameter.high:g}{unit}, {null}: {parameter.meaning}{name}"


def _aligned(lines: list[tuple[str, str]]) -> str:
    width = max((len(text) for text, _ in lines if len(text) < 48), default=0)
    return "".join(f"{text:{width}}  # {printable(about)}\n" if about else f"{text}\n" for text, about in lines)


def _comment(text: str) -> str:
    # TOML allows no control characters in comments.
    return "".join(f"# {line}\n" for line in textwrap.wrap(printable(" ".join(text.split())), _WIDTH))


def _commented(text: str) -> str:
    return "".join(line if line.startswith("#") else f"# {line}" for line in text.splitlines(keepends=True))
