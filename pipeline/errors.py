"""Typed errors.

Which one to raise:

- :class:`UsageError`: the arguments of a command or function cannot be used (exit code 2);
- :class:`ConfigError`: a TOML file (run, population, limits, model, campaign) cannot be used (2);
- :class:`MeasurementError`: a measurement cannot be read or is not a record (5);
- :class:`IntegrityError`: stored results differ from what was committed (4);
- :class:`IncompleteError`: a run stopped before its end and can be resumed (3);
- :class:`NegativeError`: the work was done, but its answer is negative (1);
- :class:`GateError`: the run is complete, but a gate that the user set failed (1);
- :class:`InterruptedRunError`: the user stopped a run, which can be resumed (130).

Every message says what is wrong, which value was found, what is allowed and what to do next.
"""

from __future__ import annotations

from typing import Any, ClassVar


class GyroscreenError(Exception):
    """Base of all errors that a user can cause and correct.

    Parameters
    ----------
    what : one clause without a full stop.
    value : the value that is wrong, shown with ``repr``; ``None`` shows none.
    allowed : the values that are accepted.
    next_step : what to do now.
    """

    exit_code: ClassVar[int] = 2

    def __init__(self, what: str, *, value: Any = None, allowed: str = "", next_step: str = "") -> None:
        super().__init__(what)
        self.what = what
        self.value = value
        self.allowed = allowed
        self.next_step = next_step

    def __str__(self) -> str:
        shown = repr(self.value)
        parts = [self.what + ("" if self.value is None else f": {shown[:200]}")]
        if self.allowed:
            parts.append(f"allowed: {self.allowed}")
        if self.next_step:
            parts.append(f"next: {self.next_step}")
        return "; ".join(parts)

    def __reduce__(self) -> tuple[Any, ...]:
        # Workers send exceptions by pickle, which by default loses keyword-only arguments.
        return (_rebuild, (type(self), self.what, self.value, self.allowed, self.next_step))


def _rebuild(kind: type[GyroscreenError], what: str, value: Any, allowed: str, next_step: str) -> GyroscreenError:
    return kind(what, value=value, allowed=allowed, next_step=next_step)


class UsageError(GyroscreenError):
    """A command or function was called with arguments that cannot be used."""


class ConfigError(GyroscreenError):
    """A TOML file (run, population, limits, model, campaign) cannot be read or has a wrong key or value."""


class NegativeError(GyroscreenError):
    """The work was done, but its answer is negative: nothing was identified, a fit failed, or a misfit is unexplained."""

    exit_code: ClassVar[int] = 1


class GateError(NegativeError):
    """A gate that the user set (yield target, strict convergence) failed."""


class InterruptedRunError(GyroscreenError):
    """The user interrupted a run; committed blocks are kept and it can be resumed."""

    exit_code: ClassVar[int] = 130


class IncompleteError(GyroscreenError):
    """A run stopped before its end; committed blocks are kept and it can be resumed."""

    exit_code: ClassVar[int] = 3


class IntegrityError(GyroscreenError):
    """Stored results differ from what the manifest says was committed."""

    exit_code: ClassVar[int] = 4


class MeasurementError(GyroscreenError):
    """A measurement cannot be read or is not a record."""

    exit_code: ClassVar[int] = 5


def unwritable(what: str, path: object, error: OSError, next_step: str = "choose another path") -> UsageError:
    """``what`` cannot be written to ``path``, with the reason that the operating system gives."""
    reason = (error.strerror or str(error)).lower()
    return UsageError(f"{what} cannot be written: {reason}", value=str(path), next_step=next_step)


def printable(text: str) -> str:
    """``text`` with control characters escaped: they would break lines of a table or be obeyed by a terminal.

    Spaces that do not break (the pages have them between number and unit) become plain ones.
    """
    text = text.replace("\u00a0", " ").replace("\u202f", " ")
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def printable_lines(text: str) -> str:
    """The same for each line of ``text``."""
    return "\n".join(printable(line) for line in text.split("\n"))
