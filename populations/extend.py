"""Population files that extend another one and state only what differs.

    extends = "cloverleaf"          a shipped population, or the path of a file, relative to this one
    without = ["lid_leak"]          irregularities of the extended population that this one does not have
    [wafer]                         keys of [device], [wafer], [operating] and of each [irregularity.NAME] replace those
    pitch_mm = 6.0                  of the extended population; irregularity_folders are added to its own

A chain of any length is one population in the end; a run stores that one, and copies of all files of the chain.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import ConfigError, GyroscreenError
from pipeline.toml_files import check_known, plain_tables, read_bytes

SPECS = Path(__file__).parent / "specs"
#: Keys of a file that extends another one, beside those of a population.
EXTENDS, WITHOUT = "extends", "without"
_FOLDERS, _IRREGULARITY = "irregularity_folders", "irregularity"
_MERGED = ("device", "wafer", "operating")


def shipped() -> tuple[str, ...]:
    """Names of the shipped populations."""
    return tuple(sorted(path.stem for path in SPECS.glob("*.toml")))


def file_of(name: str, base: Path) -> Path:
    """The file of a population: a shipped name, or a path relative to ``base`` that ends in .toml.

    Raises
    ------
    ConfigError : neither.
    """
    if name.endswith(".toml"):
        return base / name
    check_known(name, shipped(), "population", "population")
    return SPECS / f"{name}.toml"


def whole(path: Path, text: bytes | None = None) -> dict[str, Any]:
    """The tables of the population in ``path`` with all that it extends; ``text`` stands for the content of the file.

    Raises
    ------
    ConfigError : a file of the chain cannot be read or is not TOML, extends itself, or takes away what is not there.
    """
    return _whole(path, text, ())


def chain(path: Path) -> tuple[Path, ...]:
    """``path`` and the files that it extends, in this order, as far as they can be read."""
    found: list[Path] = []
    following: Path | None = path
    while following is not None and following.resolve() not in {one.resolve() for one in found}:
        found.append(following)
        try:
            name = plain_tables(read_bytes(following, "population", "", ConfigError), following.name).get(EXTENDS)
            following = file_of(name, following.parent) if isinstance(name, str) else None
        except GyroscreenError:
            following = None
    return tuple(found)


def _whole(path: Path, text: bytes | None, trail: tuple[Path, ...]) -> dict[str, Any]:
    where, here = path.name, path.resolve()
    if here in trail:
        raise ConfigError(
            "a population extends itself",
            value=" -> ".join(one.name for one in (*trail[trail.index(here) :], here)),
            allowed="a chain that ends at a complete population",
            next_step=f"remove or change extends in {trail[-1].name}",
        )
    otherwise = "check the path, or start from a copy of cloverleaf.toml in populations/specs"
    data = read_bytes(path, "population", otherwise, ConfigError) if text is None else text
    own = plain_tables(data, where)
    folders = own.get(_FOLDERS)
    if isinstance(folders, list) and all(isinstance(one, str) for one in folders):
        own = {**own, _FOLDERS: [str((here.parent / one).resolve()) for one in folders]}
    if EXTENDS not in own:
        if WITHOUT in own:
            raise ConfigError(
                f"{where}: without belongs to a file that extends another one",
                value=own[WITHOUT],
                next_step="write extends, or leave the tables of these irregularities out",
            )
        return own
    name = own[EXTENDS]
    if not isinstance(name, str):
        raise ConfigError(
            f"{where}: extends is not valid",
            value=name,
            allowed=f"{', '.join(shipped())}, or the path of a population file",
            next_step="correct extends",
        )
    base = _whole(file_of(name, path.parent), None, (*trail, here))
    return _merged(base, own, where)


def _merged(base: Mapping[str, Any], own: Mapping[str, Any], where: str) -> dict[str, Any]:
    """``base`` with what ``own`` replaces, adds and takes away; wrong types are left for the check of the whole."""
    found = {**base, **{key: value for key, value in own.items() if key not in (EXTENDS, WITHOUT)}}
    for table in _MERGED:
        found[table] = _replaced(base.get(table, {}), own.get(table, {}))
    found[_FOLDERS] = [*dict.fromkeys((*_items(base.get(_FOLDERS)), *_items(own.get(_FOLDERS))))]
    before, after = base.get(_IRREGULARITY, {}), own.get(_IRREGULARITY, {})
    if isinstance(before, dict) and isinstance(after, dict):
        taken = _taken(own.get(WITHOUT, []), before, after, where)
        names = [name for name in (*before, *(one for one in after if one not in before)) if name not in taken]
        found[_IRREGULARITY] = {name: _replaced(before.get(name, {}), after.get(name, {})) for name in names}
    return found


def _taken(names: Any, before: Mapping[str, Any], after: Mapping[str, Any], where: str) -> list[str]:
    if not isinstance(names, list):
        raise ConfigError(
            f"{where}: without is not valid", value=names, allowed="a list of names", next_step="correct without"
        )
    for name in names:
        check_known(name, before, f"{where}: without", "irregularity of the extended population")
        if name in after:
            raise ConfigError(
                f"{where}: without takes away an irregularity that the file states",
                value=name,
                allowed="one of the two",
                next_step=f"remove {name} from without, or the table [irregularity.{name}]",
            )
    return names


def _replaced(before: Any, after: Any) -> Any:
    return {**before, **after} if isinstance(before, dict) and isinstance(after, dict) else after


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
