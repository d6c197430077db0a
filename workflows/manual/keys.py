"""The pages of the TOML files, from the structs that read them: every key with type, unit, default and meaning."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, get_args, get_origin

from msgspec import NODEFAULT, Struct
from msgspec.structs import FieldInfo, fields

from pipeline.device.model_toml import ModelTable
from pipeline.experiment.campaign_tables import CampaignTable
from pipeline.experiment.files.modal_record import ModalTable
from pipeline.learning.lot.lot_file import LotFile
from pipeline.toml_faults import described, members
from pipeline.toml_files import encoded
from pipeline.toml_keys import Meaning, meanings
from populations.spec import PopulationSpec
from reports.limits import LimitsTable

from ..config import RunConfig
from .markdown import NOTE, code, number, plain, table, without_roles


@dataclass(frozen=True)
class TomlFile:
    """A kind of file: its page, its name, what it is for, the struct that reads it, and pages that explain more."""

    page: str
    name: str
    about: str
    kind: type[Struct]
    see: tuple[str, ...] = ()


FILES = (
    TomlFile(
        "campaign",
        "campaign.toml",
        "Describes the records of one device. It lies in the folder of the records; `gyroscreen init FILE...` writes one "
        "for foreign files.",
        CampaignTable,
        ("docs/how-to/sweeps.md",),
    ),
    TomlFile(
        "lot",
        "lot.toml",
        "Describes a measured lot: a table with one row per device. It lies beside the table.",
        LotFile,
        ("docs/how-to/lots.md",),
    ),
    TomlFile(
        "run",
        "run.toml: the configuration of a run",
        "The argument of `gyroscreen run`. A run stores its own as run.toml. A key that is left out has the value of the paper's "
        "experiment; `gyroscreen run --dry-run` prints all keys.",
        RunConfig,
        ("docs/how-to/limits.md", "docs/how-to/trend.md", "docs/how-to/rare-failures.md"),
    ),
    TomlFile(
        "population",
        "Population file",
        "Describes how devices of a process vary. `gyroscreen population show` prints a complete one. With "
        '`extends = "cloverleaf"` (a shipped name or a file) it states only what differs, and `without = ["lid_leak"]` takes '
        "irregularities away. {doc}`../irregularities/index` lists the parameters of each `[irregularity.NAME]`.",
        PopulationSpec,
        ("docs/how-to/populations.md",),
    ),
    TomlFile(
        "limits",
        "Limits file",
        "Limits of the result quantities ({doc}`../columns` lists them) and the rule by which a device is judged. For theta, "
        "an axis, the limits are the arc from `min` up to `max`, modulo 180 deg.",
        LimitsTable,
        ("docs/how-to/limits.md",),
    ),
    TomlFile(
        "model",
        "Model file",
        "The model that `compare`, `diagnose` and `refine` start from. `gyroscreen model add EFFECT model.toml` writes one. "
        "{doc}`../effects/index` lists the effects and their parameters.",
        ModelTable,
        ("docs/how-to/add-an-effect.md",),
    ),
    TomlFile(
        "modal",
        "Modal record",
        "Poles and residues that were identified elsewhere: each mode is (s R1 + R0) / (s^2 + 2 zeta w s + w^2). Rows are "
        "senses, columns are drives.",
        ModalTable,
    ),
)


_SHORTER = (
    (" and at most 1e+12", ""),
    (" from 0 to 1e+12", " at least 0"),
    (" from -1e+12 to 1e+12", ""),
    ("e+", "e"),
    (" that is not empty", ""),
    (", each item ", " of "),
    ("a whole number", "integer"),
    ("a number", "number"),
    ("a string", "text"),
    ("a list", "list"),
    ("a table", "table"),
)


@dataclass(frozen=True)
class KeyTable:
    """A table of a TOML file: its header as written, its struct, and what the key that holds it means."""

    header: str
    kind: type[Struct]
    meaning: str = ""


def file_pages() -> Mapping[str, str]:
    """Path below docs/reference/ -> page of each kind of file, and of their index."""
    rows = [(f"[{plain(one.name)}]({one.page}.md)", one.about) for one in FILES]
    names = "\n".join(one.page for one in FILES)
    index = (
        f"{NOTE}\n# Files and their keys\n\nAll files are TOML. A key that is unknown, has the wrong type or is out of range is "
        "named in one line, with what is allowed.\nThe unit of a key is the end of its name, or it is in the column *unit*.\n\n"
        f"{table(('file', 'content'), rows)}\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    )
    return {"files/index.md": index} | {f"files/{one.page}.md": file_page(one) for one in FILES}


def file_page(file: TomlFile) -> str:
    """Markdown of the page of a kind of file."""
    parts = [NOTE, f"# {plain(file.name)}\n", f"{file.about}\n"]
    parts += [f"See also {', '.join(code(page) for page in file.see)}.\n"] if file.see else []
    parts += [_section(one) for one in tables_of(file.kind)]
    return "\n".join(parts)


def tables_of(kind: type[Struct], header: str = "", meaning: str = "") -> Iterator[KeyTable]:
    """The tables of a file, from the top level down, each once."""
    yield KeyTable(header, kind, meaning)
    known = meanings(kind)
    for field in fields(kind):
        for inner, form in _structs(field.type):
            dotted = f"{header.strip('[]')}.{field.encode_name}" if header else field.encode_name
            yield from tables_of(inner, form.format(dotted), known[field.name].text)


def _structs(kind: Any) -> Iterator[tuple[type[Struct], str]]:
    """The structs that a type holds, and the form of their header."""
    for option in members(kind):
        base = get_args(option)[0] if hasattr(option, "__metadata__") else option
        arguments = get_args(base)
        if isinstance(base, type) and issubclass(base, Struct):
            yield base, "[{}]"
        elif get_origin(base) is dict:
            yield from ((inner, "[{}.NAME]") for item in members(arguments[1]) for inner, _ in _structs(item))
        elif get_origin(base) in (list, tuple):
            yield from ((inner, "[[{}]]") for item in arguments if item is not Ellipsis for inner, _ in _structs(item))


def _section(one: KeyTable) -> str:
    title = "## Top level\n" if not one.header else f"## {code(one.header)}\n"
    known = meanings(one.kind)
    rows = [_key(field, known[field.name]) for field in fields(one.kind)]
    about = [f"{plain(one.meaning[:1].upper() + one.meaning[1:])}.\n", *_more(one.kind)] if one.header else []
    return "\n".join([title, *about, table(("key", "meaning", "unit", "default", "allowed"), rows)])


def _key(field: FieldInfo, meaning: Meaning) -> tuple[str, str, str, str, str]:
    inner = [form.format(field.encode_name) for _, form in _structs(field.type)]
    allowed = f"table {code(inner[0])}" if inner else _allowed(field.type)
    plainly = [option for option in members(field.type) if option is not type(None) and not list(_structs(option))]
    if inner and plainly:
        allowed += " or " + " or ".join(_allowed(option) for option in plainly)
    unit = "" if meaning.unit == "1" else plain(meaning.unit)
    return code(field.encode_name), plain(meaning.text), unit, _default(field), allowed


def _allowed(kind: Any) -> str:
    """What a type allows; 1e+12, the end of a range that only keeps arithmetic finite, is left out."""
    text = described(kind)
    for long, short in _SHORTER:
        text = text.replace(long, short)
    return plain(text)


def _default(field: FieldInfo) -> str:
    if field.required:
        return "*required*"
    value = field.default if field.default is not NODEFAULT else field.default_factory()
    if value is None or isinstance(value, Struct) or value in ("", (), {}, []):
        return ""
    return code(number(value) if isinstance(value, float) else encoded(value))


def _more(kind: type[Struct]) -> list[str]:
    """What the docstring of the struct says beyond its summary."""
    paragraphs = inspect.cleandoc(kind.__doc__ or "").split("\n\n")[1:]
    return [f"{plain(without_roles(' '.join(one.split())))}\n" for one in paragraphs]
