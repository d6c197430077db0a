"""What the loop is doing, logged for whoever shows progress: loggers below "pipeline", level INFO."""

from __future__ import annotations

import logging
from collections.abc import Sequence

_LOG = logging.getLogger(__name__)


def announce_fit(terms: Sequence[str]) -> None:
    """A fit with these terms begins."""
    _LOG.info("fitting %s", " + ".join(("the given model", *terms)))


def announce(text: str) -> None:
    """A step other than a fit begins."""
    _LOG.info("%s", text)
