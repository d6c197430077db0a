"""Declaration of the command for the manual: docs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def docs(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option(help="Build into this folder; default: the user's cache, only if it is out of date.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the path of the manual and open nothing.")] = False,
    no_notebooks: Annotated[
        bool, typer.Option("--no-notebooks", help="Show the code of the notebooks without executing it.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Every warning of the build is an error.")] = False,
) -> None:
    """Open the manual in the browser; build it first if needed.

    Prints the path of its first page. The pages work offline.
    """
    from ..docs import docs as command

    command(context.find_root().command, out, opens=not no_open, notebooks=not no_notebooks, strict=strict)


COMMANDS = (docs,)
