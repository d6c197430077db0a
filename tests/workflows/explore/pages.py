"""Pages without a browser: a document whose callbacks run here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.server.callbacks import NextTickCallback

from pipeline.experiment.campaign import write_campaign
from workflows.explore import worker
from workflows.simulate import campaign_config, simulate

#: The effect that is hidden in the small campaign; it is linear, so that fits take no time.
EFFECT = "offdiagonal_damping"
_RECORDS = ("silence", "chirp", "chirp-swapped", "chirp-low", "validate-swapped")


def write_small_campaign(folder: Path) -> None:
    """Write five records of the standard campaign of a device with a hidden effect."""
    made = simulate(campaign_config(None), {}, [f"{EFFECT}:c12=0.4"], 5).campaign
    write_campaign(replace(made, records=tuple(one for one in made.records if one.name in _RECORDS)), folder)


def opened(view: Callable[[Document], None]) -> Document:
    """A document that ``view`` filled, with all answers shown."""
    document = Document()
    view(document)
    settle(document)
    return document


def settle(document: Document) -> None:
    """Let the thread of the pages finish, and run what it left to the document, until nothing is left."""
    while True:
        worker._thread().submit(lambda: None).result()
        waiting = [one for one in document.session_callbacks if isinstance(one, NextTickCallback)]
        if not waiting:
            return
        # The document keeps them in a set; a server runs them in the order in which they came.
        for one in sorted(waiting, key=lambda one: int(one.id.removeprefix("p"))):
            document.remove_next_tick_callback(one)
            one.callback()


def titled(document: Document, title: str) -> Any:
    """The control with this title."""
    return next(one for one in document.models if getattr(one, "title", None) == title)


def press(document: Document, label: str) -> None:
    """Press a button and wait for its answers."""
    from bokeh.events import ButtonClick

    button = next(one for one in document.models if getattr(one, "label", None) == label)
    assert not button.disabled
    button._trigger_event(ButtonClick(button))
    settle(document)


def words(document: Document) -> str:
    """All words of the page."""
    return "\n".join(one.text for one in document.models if isinstance(getattr(one, "text", None), str))


def source(document: Document, *columns: str) -> Any:
    """The first data source with these columns."""
    return next(one for one in document.models if set(columns) <= set(getattr(one, "column_names", ())))
