"""Declaration of `gyroscreen completion`."""

from __future__ import annotations

from typing import Annotated

import typer

from . import complete


def completion(
    shell: Annotated[
        str | None,
        typer.Argument(
            help="bash, zsh or fish; default: say how to install it.", autocompletion=complete.one_of(*complete.SHELLS)
        ),
    ] = None,
    install: Annotated[
        bool, typer.Option("--install", help="Write the script to your home folder, for new shells to load.")
    ] = False,
) -> None:
    """Complete commands, options and names with the Tab key.

    Prints the script of a shell, or installs it with --install.
    """
    from ..completion import completion as command

    command(shell, install)


COMMANDS = (completion,)
