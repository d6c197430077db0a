"""All generated pages of the manual by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .columns import columns_page
from .commands import commands_page
from .effects import effect_pages
from .keys import file_pages


def generated_pages(command_line: Any) -> Mapping[str, str]:
    """Path below docs/ -> text of every page (Markdown) and picture (SVG) that the code generates.

    Parameters
    ----------
    command_line : the group of all commands, as ``typer.main.get_command`` gives it.
    """
    reference = {"columns.md": columns_page(), "commands.md": commands_page(command_line), **file_pages(), **effect_pages()}
    return {f"reference/{name}": text for name, text in reference.items()}
