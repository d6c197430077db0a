"""All generated pages of the manual by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .columns import columns_page
from .commands import commands_page
from .effects import effect_pages
from .irregularities import irregularity_pages
from .keys import file_pages
from .python import python_page


def generated_pages(command_line: Any) -> Mapping[str, str]:
    """Path below docs/ -> text of every page (Markdown) and picture (SVG) that the code generates.

    Parameters
    ----------
    command_line : the group of all commands, as ``typer.main.get_command`` gives it.
    """
    reference = {
        "columns.md": columns_page(),
        "commands.md": commands_page(command_line),
        "python.md": python_page(),
        **file_pages(),
        **effect_pages(),
        **irregularity_pages(),
    }
    return {f"reference/{name}": text for name, text in reference.items()}
