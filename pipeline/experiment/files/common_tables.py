"""TOML tables that campaigns and modal records share."""

from __future__ import annotations

import difflib
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from ... import toml_files as toml
from ...errors import ConfigError
from ...quantities import NAMES
from ..instrument import AntiAlias

Positive = Annotated[float, Meta(gt=0.0)]


class AntiAliasTable(msgspec.Struct, forbid_unknown_fields=True):
    order: Annotated[int, Meta(ge=1, le=32)]
    corner_hz: Positive
    kind: Literal["butterworth"] = "butterworth"

    def built(self) -> AntiAlias:
        """The filter that this table states."""
        return AntiAlias(self.kind, self.order, self.corner_hz)


class DeviceTable(msgspec.Struct, forbid_unknown_fields=True):
    id: str = ""
    angular_gain: Positive | None = None


class DemodulationTable(msgspec.Struct, forbid_unknown_fields=True):
    phase_error_deg: float = 0.0
    drive: Literal["f1", "f2"] = "f1"


def references(table: dict[str, tuple[float, float]], where: str) -> dict[str, tuple[float, float]]:
    """[reference] with every quantity known and every sd positive, else :class:`ConfigError`."""
    for name, (value, sd) in table.items():
        if name not in NAMES:
            near = difflib.get_close_matches(name, NAMES, n=1, cutoff=0.5)
            raise ConfigError(
                f"{where}: [reference] names no result quantity",
                value=name,
                allowed=", ".join(NAMES),
                next_step=f"did you mean {near[0]}" if near else "choose one of them",
            )
        toml.finite(value, f"reference.{name}", where)
        toml.finite(sd, f"sd of reference.{name}", where)
        if sd <= 0.0:
            raise ConfigError(
                f"{where}: reference.{name} has no uncertainty",
                value=sd,
                allowed="[value, sd] with sd > 0",
                next_step="state its sd",
            )
    return dict(table)
