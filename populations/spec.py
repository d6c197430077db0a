"""A population as data: read from TOML, checked, changed by name, and written back exactly.

name = ".."                       [device] [wafer] [operating]: see ``nominal``
irregularity_folders = ["mine"]   optional; one file an irregularity, relative to the TOML
[irregularity.spring_thickness]   one table an irregularity; absent is no effect
lot_pct = 0.5                     a parameter left out has its null value
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from pipeline.errors import ConfigError
from pipeline.toml_files import read_table

from .irregularity import Irregularity, IrregularityParameter, find
from .layout import die_centres
from .nominal import NominalDevice, Operating, Wafer

DEFAULT = Path(__file__).parent / "specs" / "cloverleaf.toml"
ANGULAR_GAIN = "angular_gain"


class PopulationSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A checked population; ``load_spec`` makes one.  Plain data: it pickles and compares by value."""

    name: str
    irregularity_folders: tuple[str, ...] = ()
    device: NominalDevice
    wafer: Wafer
    operating: Operating
    irregularity: dict[str, dict[str, float]] = {}

    @property
    def angular_gain(self) -> float:
        """kappa = I_p / I_0p."""
        return self.device.angular_gain

    def found(self) -> tuple[tuple[Irregularity, Mapping[str, float]], ...]:
        """The irregularities of this population with all their parameters, by name."""
        known = find(self.irregularity_folders)
        return tuple((known[name], _filled(known[name], self.irregularity[name])) for name in sorted(self.irregularity))

    def assumptions(self) -> dict[str, float]:
        """Value of every named assumption of this population, ``angular_gain`` among them."""
        values = {
            parameter.assumption: given[parameter.name]
            for irregularity, given in self.found()
            for parameter in irregularity.parameters
            if parameter.assumption
        }
        return {ANGULAR_GAIN: self.angular_gain, **values}

    def with_values(self, values: Mapping[str, float]) -> PopulationSpec:
        """The same population with other values.

        Parameters
        ----------
        values : named assumption (``residual_anisotropy`` [%], ``angular_gain`` [1], ``damping_anisotropy``
        [1],
            ``package_stress`` [MPa]) or "irregularity.parameter" -> value in the parameter's unit.

        Raises
        ------
        ConfigError : unknown name, or a value of the wrong type or out of range.
        """
        targets = {ANGULAR_GAIN: ("device", ANGULAR_GAIN)}
        for irregularity, _ in self.found():
            for parameter in irregularity.parameters:
                target = (irregularity.name, parameter.name)
                targets[".".join(target)] = target
                if parameter.assumption:
                    targets[parameter.assumption] = target
        data = msgspec.to_builtins(self)
        for name, value in values.items():
            _check_key("assumption", name, value, targets)
            table, key = targets[name]
            (data["device"] if table == "device" else data["irregularity"][table])[key] = value
        return _checked(data, Path())

    def to_toml(self) -> str:
        """TOML that reads back to an equal population."""
        data = msgspec.to_builtins(self)
        tables = {key: data.pop(key) for key in ("device", "wafer", "operating")}
        tables |= {f"irregularity.{name}": values for name, values in sorted(data.pop("irregularity").items())}
        lines = [f"{key} = {_literal(value)}" for key, value in data.items()]
        for name, values in tables.items():
            lines += ["", f"[{name}]", *(f"{key} = {_literal(value)}" for key, value in values.items())]
        return "\n".join(lines) + "\n"


def load_spec(path: Path | None = None) -> PopulationSpec:
    """Read and check a population; ``None`` is the shipped cloverleaf.

    Raises ConfigError on a missing or malformed file, an unknown key, a wrong type or unit, a value out of
    range.
    """
    source = DEFAULT if path is None else path
    otherwise = f"start from a copy of {DEFAULT.name} in populations/specs"
    data = read_table(source, "population", ", ".join(PopulationSpec.__struct_fields__), otherwise)
    return _checked(data, source.resolve().parent)


def _checked(data: dict[str, Any], base: Path) -> PopulationSpec:
    _check_struct("", data, PopulationSpec)
    for table, kind in (("device", NominalDevice), ("wafer", Wafer), ("operating", Operating)):
        _check_struct(table, data.get(table), kind)
    _check_finite("", data)
    _check_numbers(data.get("irregularity", {}))
    try:
        spec = msgspec.convert(data, PopulationSpec)
    except msgspec.ValidationError as error:
        text, _, where = str(error).partition(" - at `$")
        raise ConfigError(
            f"population key {where.strip('`.') or '(top level)'} is wrong",
            value=_look_up(data, where.strip("`.")),
            allowed=text.replace("`", ""),
            next_step="correct it; its unit is the end of its name",
        ) from error
    folders = tuple(str((base / folder).resolve()) for folder in spec.irregularity_folders)
    spec = msgspec.structs.replace(spec, irregularity_folders=folders)
    known = find(folders)
    for name, values in spec.irregularity.items():
        _check_key("irregularity", name, values, known)
        _check_values(known[name], values)
    _check_device(spec.device)
    die_centres(spec.wafer)
    return spec


def _check_struct(table: str, data: Any, kind: type[msgspec.Struct]) -> None:
    if isinstance(data, dict):
        for key, value in data.items():
            _check_key(f"key in [{table}]" if table else "key at the top", key, value, kind.__struct_fields__)


def _check_key(kind: str, name: str, value: Any, allowed: Iterable[str]) -> None:
    names = list(allowed)
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        raise ConfigError(
            f"unknown {kind} of the population: {name}",
            value=value,
            allowed=", ".join(names) or "none",
            next_step=f"did you mean {near[0]}?" if near else "remove it or correct its name",
        )


def _check_values(irregularity: Irregularity, values: Mapping[str, float]) -> None:
    parameters = {parameter.name: parameter for parameter in irregularity.parameters}
    for name, value in values.items():
        _check_key(f"parameter of irregularity {irregularity.name}", name, value, parameters)
        _check_range(irregularity.name, parameters[name], value)
    for parameter in irregularity.parameters:
        if parameter.null is None and parameter.name not in values:
            raise ConfigError(
                f"irregularity {irregularity.name} lacks {parameter.name}, {parameter.meaning}",
                allowed=f"{parameter.low:g} to {parameter.high:g} {parameter.unit}",
                next_step=f"state it in [irregularity.{irregularity.name}]",
            )


def _check_range(owner: str, parameter: IrregularityParameter, value: float) -> None:
    if not parameter.low <= value <= parameter.high:
        raise ConfigError(
            f"{owner}.{parameter.name} ({parameter.meaning}) is out of range",
            value=value,
            allowed=f"{parameter.low:g} to {parameter.high:g} {parameter.unit}",
            next_step="correct it; its unit is the end of its name",
        )


def _check_device(device: NominalDevice) -> None:
    other = 1.0 / device.quality_anchor + 1.0 / device.quality_thermoelastic
    for name in ("quality_rocking", "quality_updown"):
        if not 1.0 / getattr(device, name) > other:
            raise ConfigError(
                f"device.{name} leaves no loss to the gas",
                value=getattr(device, name),
                allowed=f"below {1.0 / other:.6g}, what anchor and thermoelastic loss alone give",
                next_step="lower it, or raise quality_anchor or quality_thermoelastic",
            )


def _check_numbers(tables: Any) -> None:
    # msgspec does not name the key of a dict in its messages.
    for name, values in tables.items() if isinstance(tables, dict) else ():
        for key, value in values.items() if isinstance(values, dict) else ():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ConfigError(
                    f"population key irregularity.{name}.{key} is no number",
                    value=value,
                    allowed="a number in the unit at the end of its name",
                    next_step="correct it",
                )


def _check_finite(where: str, data: Any) -> None:
    if isinstance(data, dict):
        for key, value in data.items():
            _check_finite(f"{where}.{key}".lstrip("."), value)
    elif isinstance(data, (list, tuple)):
        for value in data:
            _check_finite(where, value)
    elif isinstance(data, float) and not math.isfinite(data):
        raise ConfigError(
            f"population key {where} is not finite",
            value=data,
            allowed="a finite number",
            next_step="correct it",
        )


def _filled(irregularity: Irregularity, given: Mapping[str, float]) -> Mapping[str, float]:
    null = {parameter.name: parameter.null for parameter in irregularity.parameters if parameter.null is not None}
    return {**null, **given}


def _look_up(data: Any, where: str) -> Any:
    for key in where.split("."):
        data = data.get(key.split("[")[0]) if isinstance(data, dict) else data
    return data


def _literal(value: Any) -> str:
    if isinstance(value, str):
        # A JSON string is a TOML basic string.
        return msgspec.json.encode(value).decode()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_literal(item) for item in value) + "]"
    return repr(value)
