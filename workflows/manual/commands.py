"""The page of the commands, from the declared command line."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import typer

from .markdown import NOTE, block, code, plain, table

_ABOUT = """\
# Commands

Each command prints its own help with `--help`. A wrong argument or a wrong file gives one line that says what is wrong, what is
allowed and what to do next; [exit codes](exit-codes.md) lists the code of each outcome.
"""


def commands_page(command_line: Any) -> str:
    """Markdown of the page.

    Parameters
    ----------
    command_line : the group of all commands, as ``typer.main.get_command`` gives it.
    """
    top = [_described("gyroscreen", command_line, level=2)] if _options(command_line) else []
    sections = [_described(name, command, level=2) for name, command in _leaves("gyroscreen", command_line)]
    listed = [
        (f"[`{name}`](#{anchor(name)})", plain(_summary(one))) for name, one in _leaves("gyroscreen", command_line)
    ]
    return "\n".join([NOTE, _ABOUT, table(("command", "what it does"), listed), *top, *sections])


def anchor(name: str) -> str:
    """Anchor of a command on the page."""
    return name.replace(" ", "-")


def _leaves(prefix: str, group: Any) -> Iterator[tuple[str, Any]]:
    """Full name and command of every command that does something, hidden ones last."""
    named = ((name, group.commands[name]) for name in group.list_commands(typer.Context(group)))
    for name, command in sorted(named, key=lambda item: item[1].hidden):
        if hasattr(command, "commands"):
            yield from _leaves(f"{prefix} {name}", command)
        else:
            yield f"{prefix} {name}", command


def _described(name: str, command: Any, level: int) -> str:
    """A section: what the command does, usage, arguments, options."""
    context = typer.Context(command, info_name=name)
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    usage = " ".join([name, *(["[OPTIONS]"] if _options(command) else []), *map(_placed, arguments)])
    usage += " COMMAND .." if hasattr(command, "commands") else ""
    about = inspect.cleandoc(command.help or "").split("\n\n")
    given = [(code(_placed(one)), plain(one.help or "")) for one in arguments]
    options = [(code(_written(one, context)), _default(one), plain(one.help or "")) for one in _options(command)]
    return "\n".join(
        [
            f"{'#' * level} {name}\n",
            *(f"{plain(' '.join(part.split()))}\n" for part in about),
            block(usage),
            table(("argument", "meaning"), given),
            table(("option", "default", "meaning"), options),
        ]
    )


def _options(command: Any) -> list[Any]:
    """The options of a command but those that every one has: --help, and --debug of the whole command line."""
    common = {"--help"} if hasattr(command, "commands") else {"--help", "--debug"}
    return [one for one in command.params if one.param_type_name == "option" and not common & set(one.opts)]


def _summary(command: Any) -> str:
    """The first sentence of the help."""
    return inspect.cleandoc(command.help or "").split("\n\n")[0].replace("\n", " ")


def _placed(argument: Any) -> str:
    """An argument as it stands in the usage: NAME, [NAME], NAME..."""
    name = (argument.metavar or argument.name).upper().strip("[]").removesuffix("...")
    name += "..." if argument.nargs == -1 else ""
    return name if argument.required else f"[{name}]"


def _written(option: Any, context: typer.Context) -> str:
    """An option as it is written: --seed INT."""
    form = str(option.get_help_record(context)[0])
    return re.sub(r"<(?:list\[)?(.*?)\]?>", lambda kind: kind[1].upper() if "|" not in kind[1] else kind[1], form)


def _default(option: Any) -> str:
    """The default; an empty cell where there is none."""
    value = option.default() if callable(option.default) else option.default
    if option.required:
        return "must be given"
    if value is None or value is False or value in ("", []):
        return ""
    return code("on" if value is True else str(value))
