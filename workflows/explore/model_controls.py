"""The controls that add a part to a model and remove it, which the pages of campaigns and lots share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from bokeh.models import Column
from bokeh.models.widgets.buttons import Button
from bokeh.models.widgets.inputs import Select

from .parts import controls, error_line, offer, paragraphs, say, stacked, text


class ModelControls:
    """Two lists with a button each, and what is said about the choice.

    Parameters
    ----------
    absent, present : titles of the lists of what may be added, and of what may be removed.
    width : of the second list [px].
    change : called with the names that the user wants in the model.
    """

    def __init__(self, absent: str, present: str, width: int, change: Callable[[tuple[str, ...]], None]) -> None:
        self._change = change
        self._names: tuple[str, ...] = ()
        self.add = Select(title=absent, width=380)
        self.remove = Select(title=present, width=width)
        self.adding = Button(label="Add and refit", button_type="primary", width=130, align="end", disabled=True)
        self.removing = Button(label="Remove", width=90, align="end", disabled=True)
        self.status = text(live=True)
        self.error = text()
        self.error.visible = False
        self.verdict = text(live=True)
        self.adding.on_click(self._add)
        self.removing.on_click(self._remove)

    @property
    def element(self) -> Column:
        """The controls, with the sentences below them."""
        both = controls(self.add, self.adding, self.remove, self.removing)
        return stacked(both, self.status, self.error, self.verdict)

    def chosen(self, names: tuple[str, ...], words: Mapping[str, str] | Sequence[str]) -> None:
        """Show what is in the model now, or will be once the fit is done; ``words`` are the names as they are shown."""
        self._names = names
        offer(self.remove, words)
        self.remove.value = names[-1] if names else ""
        self.removing.disabled = not names

    def offered(self, words: Mapping[str, str], first: str) -> None:
        """Offer what may be added, ``first`` selected."""
        offer(self.add, words)
        self.add.value = first
        self.adding.disabled = not words

    def doing(self, line: str) -> None:
        """Show what is being done."""
        self.status.text = paragraphs([line])

    def fail(self, line: str) -> None:
        """Show why the last wish failed; "" where it did not."""
        say(self.error, error_line(line))

    def _add(self) -> None:
        if self.add.value and self.add.value not in self._names:
            self._change((*self._names, str(self.add.value)))

    def _remove(self) -> None:
        self._change(tuple(name for name in self._names if name != self.remove.value))
