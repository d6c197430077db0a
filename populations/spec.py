"""Populations: read from TOML, checked, changed by name, and written back exactly.

name = ".."                       [device] [wafer] [operating]: see ``nominal``
extends = "cloverleaf"            optional: the file states only what differs; see ``extend``
irregularity_folders = ["mine"]   optional: folders with your own irregularities, relative to this file
[irregularity.spring_thickness]   one table per irregularity; without a table it is not in the population
lot_pct = 0.5                     a parameter that is left out has its null value
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from pipeline.errors import ConfigError
from pipeline.toml_files import check_known, converted, decode, table
from pipeline.toml_keys import Meaning

from .extend import EXTENDS, SPECS, WITHOUT, whole
from .irregularity import Irregularity, IrregularityParameter, find
from .layout import die_centres
from .nominal import NominalDevice, Operating, Wafer

DEFAULT = SPECS / "cloverleaf.toml"
ANGULAR_GAIN = "angular_gain"


class PopulationSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A population.  :func:`load_spec` returns a checked one; instances pickle and compare by value."""

    name: Annotated[str, Meaning("name of the population in reports")]
    irregularity_folders: Annotated[
        tuple[str, ...], Meaning("folders with your own irregularities, relative to this file")
    ] = ()
    device: Annotated[NominalDevice, Meaning("the device as designed")]
    wafer: Annotated[Wafer, Meaning("wafer, lots and wafers of a batch")]
    operating: Annotated[Operating, Meaning("operating point of packaged devices")]
    irregularity: Annotated[
        dict[str, dict[str, float]],
        Meaning("irregularities of the population, one table each with its parameters", "that of the parameter"),
    ] = {}

    @property
    def angular_gain(self) -> float:
        """kappa = I_p / I_0p."""
        return self.device.angular_gain

    @property
    def bias_ratio(self) -> float:
        """Operating bias over the nominal one [1]."""
        return self.operating.bias_v / self.device.nominal_bias_v

    def found(self) -> tuple[tuple[Irregularity, Mapping[str, float]], ...]:
        """The irregularities of this population, sorted by name, each with all its parameters."""
        known = find(self.irregularity_folders)
        return tuple((known[name], _filled(known[name], self.irregularity[name])) for name in sorted(self.irregularity))

    def assumptions(self) -> dict[str, float]:
        """Value of every named assumption of this population, including ``angular_gain``."""
        values = {
            parameter.assumption: given[parameter.name]
            for irregularity, given in self.found()
            for parameter in irregularity.parameters
            if parameter.assumption
        }
        return {ANGULAR_GAIN: self.angular_gain, **values}

    def with_values(self, values: Mapping[str, float]) -> PopulationSpec:
        """The population with other values.

        Parameters
        ----------
        values : values in the unit of the parameter, by named assumption (``residual_anisotropy`` [%], ``angular_gain`` [1],
            ``damping_anisotropy`` [1], ``package_stress`` [MPa]) or by "irregularity.parameter".

        Raises
        ------
        ConfigError : an unknown name, a value of the wrong type, or one out of range.
        """
        targets = {ANGULAR_GAIN: ("device", ANGULAR_GAIN)}
        for irregularity, _ in self.found():
            for parameter in irregularity.parameters:
                target = (irregularity.name, parameter.name)
                targets[".".join(target)] = target
                if parameter.assumption:
                    targets[parameter.assumption] = target
        data = msgspec.to_builtins(self)
        where = f"population {self.name}"
        for name, value in values.items():
            check_known(name, targets, where, "assumption")
            owner, key = targets[name]
            (data["device"] if owner == "device" else data["irregularity"][owner])[key] = value
        return _checked(converted(data, PopulationSpec, where), Path(), where)

    def to_toml(self) -> str:
        """TOML text that reads back to an equal population."""
        data = msgspec.to_builtins(self)
        tables = {key: data.pop(key) for key in ("device", "wafer", "operating")}
        tables |= {f"irregularity.{name}": values for name, values in sorted(data.pop("irregularity").items())}
        # An irregularity without values is present, so its header is written.
        parts = (table(f"[{name}]", values) or f"[{name}]\n" for name, values in tables.items())
        return "\n".join([table("", data), *parts])


def load_spec(path: Path | None = None, text: str | None = None) -> PopulationSpec:
    """The population in the TOML file ``path``; ``None`` is the shipped cloverleaf.

    Parameters
    ----------
    text : stands for the content of the file, which need not exist.

    Raises
    ------
    ConfigError : a file cannot be read; an unknown key; a wrong type; a value out of range; a chain that extends itself.
    """
    source = DEFAULT if path is None else path
    where = source.name
    tables = whole(source, None if text is None else text.encode())
    for key in tables:
        check_known(key, (*PopulationSpec.__struct_fields__, EXTENDS, WITHOUT), where)
    return _checked(converted(tables, PopulationSpec, where), source.resolve().parent, where)


def spec_from_toml(text: str, where: str) -> PopulationSpec:
    """The population in ``text``, as :meth:`PopulationSpec.to_toml` writes it; raises as :func:`load_spec`."""
    return _checked(decode(text.encode(), PopulationSpec, where), Path(), where)


def _checked(spec: PopulationSpec, base: Path, where: str) -> PopulationSpec:
    """``spec`` with absolute folders, after all checks that go beyond single values; ``where`` names its file."""
    folders = tuple(str((base / folder).resolve()) for folder in spec.irregularity_folders)
    known = find(folders)
    for name, values in spec.irregularity.items():
        check_known(name, known, where, "irregularity")
        _check_values(known[name], values, f"{where}: [irregularity.{name}]")
    _check_losses(spec.device, where)
    die_centres(spec.wafer)
    return msgspec.structs.replace(spec, irregularity_folders=folders)


def _check_values(irregularity: Irregularity, values: Mapping[str, float], where: str) -> None:
    parameters = {parameter.name: parameter for parameter in irregularity.parameters}
    for name, value in values.items():
        check_known(name, parameters, where, "parameter")
        parameter = parameters[name]
        if not parameter.low <= value <= parameter.high:
            raise ConfigError(
                f"{where} {name} ({parameter.meaning}) is out of range",
                value=value,
                allowed=_range(parameter),
                next_step=f"correct {name}; its unit is the end of its name",
            )
    for parameter in irregularity.parameters:
        if parameter.null is None and parameter.name not in values:
            raise ConfigError(
                f"{where} lacks {parameter.name} ({parameter.meaning})",
                allowed=_range(parameter),
                next_step=f"write {parameter.name}",
            )


def _range(parameter: IrregularityParameter) -> str:
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.low:g} to {parameter.high:g}{unit}"


def _check_losses(device: NominalDevice, where: str) -> None:
    """The gas must account for a part of the losses: 1/Q > 1/Q_anchor + 1/Q_thermoelastic."""
    other = 1.0 / device.quality_anchor + 1.0 / device.quality_thermoelastic
    for name in ("quality_rocking", "quality_updown"):
        if not 1.0 / getattr(device, name) > other:
            raise ConfigError(
                f"{where}: device.{name} leaves no loss to the gas",
                value=getattr(device, name),
                allowed=f"below {1.0 / other:.6g}, the Q of anchor and thermoelastic losses alone",
                next_step="lower it, or raise quality_anchor or quality_thermoelastic",
            )


def _filled(irregularity: Irregularity, given: Mapping[str, float]) -> Mapping[str, float]:
    null = {parameter.name: parameter.null for parameter in irregularity.parameters if parameter.null is not None}
    return {**null, **given}
