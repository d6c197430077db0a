"""The command list of ``gyroscreen --help`` by task, and --debug after every command."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from typer.core import TyperGroup

SCREEN = "Screen a population"
RESULTS = "Results of a run"
DEVICE = "One device"
LEARN = "Learn what a device or a lot lacks"
LIBRARY = "Populations and models"
STUDIES = "Studies"
HELP = "Help"
#: The task of each command, in the order of the list; a command without a line is listed under "Help".
TASK_OF = {
    "run": SCREEN,
    "rare": SCREEN,
    "report": RESULTS,
    "explore": RESULTS,
    "query": RESULTS,
    "attribute": RESULTS,
    "grr": RESULTS,
    "export": RESULTS,
    "verify": RESULTS,
    "init": DEVICE,
    "check": DEVICE,
    "identify": DEVICE,
    "simulate": DEVICE,
    "compare": LEARN,
    "diagnose": LEARN,
    "refine": LEARN,
    "demo": LEARN,
    "population": LIBRARY,
    "model": LIBRARY,
    "effects": LIBRARY,
    "paper": STUDIES,
    "benchmark": STUDIES,
    "docs": HELP,
    "completion": HELP,
}
_PLACE = {name: place for place, name in enumerate(TASK_OF)}


class CommandsByTask(TyperGroup):
    """The root command, whose help lists the commands by task."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names in the order of the list."""
        return sorted(super().list_commands(ctx), key=lambda name: _PLACE.get(name, len(_PLACE)))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one section for each task."""
        shown = {name: command for name in self.list_commands(ctx) if not (command := self.commands[name]).hidden}
        # As in the list without sections: two columns of margin and spacing on each side of the name.
        width = formatter.width - 6 - max(map(len, shown))
        for task in dict.fromkeys(TASK_OF.get(name, HELP) for name in shown):
            with formatter.section(task):
                formatter.write_dl(
                    [
                        (f"{name:<{max(map(len, shown))}}", command.get_short_help_str(width))
                        for name, command in shown.items()
                        if TASK_OF.get(name, HELP) == task
                    ]
                )


def show_tracebacks(wanted: bool) -> None:
    """Let errors of this process and of its workers print their tracebacks, where ``wanted``."""
    if wanted:
        os.environ["GYROSCREEN_DEBUG"] = "1"


def with_debug_everywhere(root: Any) -> Any:
    """``root``, a command line that typer has just made, with its flag --debug on every command."""
    flag = next(one for one in root.params if one.name == "debug")
    for command in _below(root):
        command.params.append(flag)
    return root


def _below(group: Any) -> Iterator[Any]:
    for command in group.commands.values():
        yield command
        if isinstance(command, TyperGroup):
            yield from _below(command)
