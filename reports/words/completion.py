"""Installation of shell completion in words."""

from __future__ import annotations

from pathlib import Path

HOW_TO = """\
The Tab key can complete commands, options, and the names of effects, irregularities, populations and runs.

To install it, once:
  gyroscreen completion bash --install    # writes ~/.bash_completions/gyroscreen.sh, and a line to ~/.bashrc
  gyroscreen completion zsh --install     # writes ~/.zfunc/_gyroscreen, and lines to ~/.zshrc
  gyroscreen completion fish --install    # writes ~/.config/fish/completions/gyroscreen.fish

To use it in this shell alone (bash; zsh alike):
  source <(gyroscreen completion bash)"""


def installed_line(script: Path) -> str:
    """What the command prints when it has written the script."""
    return f"{script}: new shells complete gyroscreen"
