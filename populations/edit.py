"""Add an irregularity to a population file, or drop it, without touching the other lines.

Whatever form the file has, the result is read again and must differ in that irregularity alone.
"""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from pipeline.errors import ConfigError, printable
from pipeline.toml_files import check_known, encoded, plain_tables

from .describe import irregularity_table, levels_of, values_of
from .extend import EXTENDS, WITHOUT
from .irregularity import find
from .spec import PopulationSpec, load_spec


def added(name: str, path: Path, text: str | None) -> str:
    """The text of the population file ``path`` with the irregularity ``name``.

    ``text`` is its content; ``None`` starts a file that extends the shipped population.

    The table has the values of the population where it inherits the irregularity, else those of the shipped population, else null
    values.

    Raises
    ------
    ConfigError : the file cannot be used, there is no such irregularity, or the file states it already.
    """
    whole = _new(path) if text is None else text
    spec = load_spec(path, whole)
    known = find(spec.irregularity_folders)
    check_known(name, known, path.name, "irregularity")
    own = plain_tables(whole.encode(), path.name)
    if name in own.get("irregularity", {}):
        raise ConfigError(
            f"{path.name}: the file states this irregularity already", value=name, next_step="change its values there"
        )
    if name in own.get(WITHOUT, []):
        whole = _with_without(whole, [one for one in own[WITHOUT] if one != name], path)
    inherited = load_spec(path, whole)
    values = values_of(known[name], inherited if name in inherited.irregularity else load_spec())
    block = irregularity_table(known[name], values, levels_of(spec)[name])
    return _checked(f"{whole.rstrip()}\n\n{block}", path, spec, name, True)


def dropped(name: str, path: Path, text: str) -> str:
    """The text of the population file without the irregularity ``name``.

    Its table goes, and an inherited one is named in ``without``.

    Raises
    ------
    ConfigError : the file cannot be used, or its population does not have the irregularity.
    """
    spec = load_spec(path, text)
    check_known(name, spec.irregularity, path.name, "irregularity")
    own = plain_tables(text.encode(), path.name)
    whole = _without_table(text, name) if name in own.get("irregularity", {}) else text
    if EXTENDS in own and name in load_spec(path, whole).irregularity:
        whole = _with_without(whole, [*own.get(WITHOUT, []), name], path)
    return _checked(whole, path, spec, name, False)


def _new(path: Path) -> str:
    name = encoded(path.stem)
    return (
        f"# Population {name}: the shipped cloverleaf with the changes below.  All of it: "
        f"`gyroscreen population show {printable(path.name)}`.\n"
        f'name = {name}\nextends = "cloverleaf"\n'
    )


def _without_table(text: str, name: str) -> str:
    """``text`` without the lines of [irregularity.name] and the comments right above it."""
    lines = text.splitlines(keepends=True)
    header = re.compile(rf"\s*\[\s*irregularity\s*\.\s*[\"']?{re.escape(name)}[\"']?\s*\]")
    first = next((k for k, line in enumerate(lines) if header.match(line)), None)
    if first is None:
        return text
    last = first + 1
    while last < len(lines) and not lines[last].lstrip().startswith("["):
        last += 1
    # Comments at the end belong to the next table.
    while last > first + 1 and (lines[last - 1].startswith("#") or not lines[last - 1].strip()) and last < len(lines):
        last -= 1
    while first > 0 and lines[first - 1].startswith("#"):
        first -= 1
    kept = [*lines[:first], *lines[last:]]
    return re.sub(r"\n{3,}", "\n\n", "".join(kept))


def _with_without(text: str, names: list[str], path: Path) -> str:
    """``text`` with ``without = names``; the line goes where no name is left."""
    line = re.compile(rf"^{WITHOUT}\s*=\s*\[[^\]]*\][^\n]*\n?", re.MULTILINE)
    now = f"{WITHOUT} = {encoded(names)}\n" if names else ""
    if line.search(text):
        return line.sub(lambda _: now, text, count=1)
    # Right below extends: a key of the top level must stand before the first table.
    return re.sub(
        rf"^({EXTENDS}\s*=[^\n]*\n?)", lambda found: f"{found[1].rstrip()}\n{now}", text, count=1, flags=re.MULTILINE
    )


def _checked(text: str, path: Path, before: PopulationSpec, name: str, there: bool) -> str:
    """``text`` if its population is ``before`` but for the irregularity ``name``."""
    try:
        after = load_spec(path, text)
        rest = [
            msgspec.structs.replace(one, irregularity={k: v for k, v in one.irregularity.items() if k != name})
            for one in (before, after)
        ]
        right = rest[0] == rest[1] and (name in after.irregularity) == there
    except ConfigError:
        right = False
    if not right:
        raise ConfigError(
            f"{path.name}: the file cannot be changed without changing more than this irregularity",
            value=name,
            allowed=f"a table [irregularity.{name}] of its own, and extends and without at the start of lines",
            next_step="change the file by hand",
        )
    return text
