"""What an export says on a terminal."""

from __future__ import annotations


def cut_sentence(cut: int) -> str:
    """Texts that a field of STDF cannot hold."""
    return f"{cut} {'text was' if cut == 1 else 'texts were'} cut to 255 characters, the longest that STDF holds"


def unplaced_sentence(unplaced: int) -> str:
    """Devices without a place on the integer grid of a wafer map."""
    what = "device has" if unplaced == 1 else "devices have"
    return f"{unplaced} {what} no die coordinates: the position is unknown or not on a grid"


def unfinished_sentence(run: str, devices: int) -> str:
    """A run that is not complete."""
    return f"the run {run} is not complete: its {devices} stored devices were exported"
