"""Numbers, quantities, limits and places in words, and the sentences at the head of the nightly report.  No HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from pipeline.performance.figure import find_figures
from pipeline.quantities import QUANTITIES

if TYPE_CHECKING:
    # For annotations only: pages without yields need not load their statistics, which is slow.
    from pipeline.device.effect import Effect
    from pipeline.learning.answers import Place

    from ..clusters import Clustering
    from ..limits import Limit
    from ..run.causes import FailedLimit, Pareto, StageLoss
    from ..run.health import StatusCount
    from ..yields import Yield

UNITS = {quantity.name: "" if quantity.unit == "1" else quantity.unit for quantity in QUANTITIES}

# A non-breaking space keeps the sign with its number.
PERCENT = "\u00a0%"
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_GREEK = {
    "psi": "ψ", "omega": "ω", "Omega": "Ω", "zeta": "ζ", "theta": "θ", "gamma": "γ", "beta": "β", "tau": "τ", "eps": "ε",
    "phi": "φ", "alpha": "α", "delta": "δ", "pi": "π",
}  # fmt: skip

LABELS = {
    "theta_deg": "theta",
    "split_hz": "split",
    "f1_hz": "lower rocking frequency",
    "f2_hz": "upper rocking frequency",
    "f3_hz": "up-down frequency",
    "zeta1": "lower damping ratio",
    "zeta2": "upper damping ratio",
    "zeta3": "up-down damping ratio",
    "c12_per_s": "off-diagonal damping",
    "rocking_gain": "rocking gain",
    "updown_gain": "up-down gain",
    "sense_imbalance": "sense imbalance",
    "drive_imbalance": "drive imbalance",
    "quality1": "lower quality factor",
    "quality2": "upper quality factor",
    "quality3": "up-down quality factor",
    "quadrature_rate_dps": "quadrature rate",
    "quadrature_bias_dps": "quadrature bias",
    "inphase_bias_dps": "in-phase bias",
    "rate_bias_dps": "rate bias",
    **{name: figure.label for name, figure in find_figures().items()},
}


def label(quantity: str) -> str:
    """A quantity in words."""
    return LABELS.get(quantity, quantity)


def symbol_words(name: str) -> str:
    """Symbol of a parameter: "cubic_stiffness.k3" is "k3", "c12_per_s" is "c12"."""
    symbol = name.rpartition(".")[2]
    return next((symbol.removesuffix(end) for end in ("_per_s", "_hz", "_deg") if symbol.endswith(end)), symbol)


def unit_of(name: str, effects: Mapping[str, Effect]) -> str:
    """Unit of a result quantity or of a parameter of an effect ("cubic_stiffness.k3"); "" for a pure number."""
    if name in UNITS:
        return UNITS[name]
    owner, _, symbol = name.rpartition(".")
    parameters = effects[owner].parameters if owner in effects else ()
    # Members of a family have a suffix: k2x of k2, C_s1d2 of C.
    own = [one.unit for one in parameters if one.name == symbol or (one.per and symbol.startswith(one.name))]
    unit = own[0] if own else "Hz" if name.endswith("_hz") else "deg" if name.endswith("_deg") else ""
    return "" if unit == "1" else unit


def with_unit(value: float, quantity: str) -> str:
    """A limit of a quantity with its unit."""
    return f"{value:.6g} {UNITS.get(quantity, '')}".replace("-", "−").strip()


def limit_words(limit: Limit) -> str:
    """A limit as an inequality or an arc."""
    unit = UNITS.get(limit.quantity, "")
    low, high = (f"{end:.6g}".replace("-", "−") for end in (limit.low, limit.high))
    if math.isinf(limit.low):
        return f"≤ {high} {unit}".strip()
    if math.isinf(limit.high):
        return f"≥ {low} {unit}".strip()
    return f"{low} to {high} {unit}".strip()


def percent(share: float) -> str:
    """A share (0 to 1) in percent, with enough digits to distinguish it from 0 and 100 %."""
    if math.isnan(share):
        return "–"
    digits = 1 if 0.001 <= share <= 0.999 or share in (0.0, 1.0) else 2
    text = f"{100.0 * share:.{digits}f}"
    return f"{text.removesuffix('.0') if share in (0.0, 1.0) else text}{PERCENT}"


def percent_range(low: float, high: float) -> str:
    """A range of shares (0 to 1) in percent."""
    return f"{percent(low).removesuffix(PERCENT)} to {percent(high)}"


def partition_words(partition: str) -> str:
    """The groups of records between which a size differs."""
    named = {"block": "records", "": "records", "level": "drive levels", "direction": "sweep directions"}
    return named.get(partition, f"{partition}s")


def family_words(family: str) -> str:
    """A family of places, as in "by ..."."""
    named = {"response": "response level", "entry": "mode and entry (sense/drive)"}
    return named.get(family, partition_words(family).removesuffix("s"))


def kind_words(kind: str, order: int | None = None) -> str:
    """A kind of place, with the order of a harmonic."""
    if kind != "harmonic" or order is None:
        return {"line": "fixed line", "harmonic": "harmonic of the drive"}.get(kind, kind)
    ending = {2: "nd", 3: "rd"}.get(order, "th")
    return "drive frequency" if order == 1 else f"{order}{ending} harmonic of the drive"


def place_words(place: Place) -> str:
    """Where a place lies: kind, band, time, record, channel and whatever else labels it."""
    band = None if place.band_hz is None else (place.band_hz[0] + place.band_hz[1]) / 2.0
    if place.mode:
        return f"mode {place.mode} ({band:.1f} Hz), {entry_words(place)}"
    parts = [kind_words(place.kind, place.harmonic or None)] if (place.family or "frequency") == "frequency" else []
    if place.band_hz is not None:
        parts.append(f"{band:.6g} Hz" if place.kind == "line" else f"{_span(place.band_hz)} Hz")
    if place.time_s:
        parts.append(f"{_span(place.time_s)} s")
    if place.record is not None:
        parts.append(place.record)
    if place.channel is not None:
        parts.append(f"sense {place.channel.removeprefix('sense')}")
    if place.response_v:
        parts.append(f"{_span(place.response_v)} V rms")
    if place.direction:
        parts.append(place.direction)
    if isinstance(place.level, float):
        parts.append("largest level" if place.level == 1.0 else f"{place.level:.4g} of the largest level")
    elif place.level:
        parts.append(place.level)
    return ", ".join(parts) or "all data"


def entry_words(place: Place) -> str:
    """Entry of a mode: "S1/D2"."""
    return f"{(place.channel or '').replace('sense', 'S')}/{(place.drive or '').replace('drive', 'D')}"


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}"


def error_words(value: float | None, relative: bool = False) -> str:
    """An error with the digits that matter: two decimals near the noise, three figures far above it."""
    if value is None or not math.isfinite(value):
        return "–"
    if relative:
        return percent(value) if value >= 0.01 else f"{100.0 * value:.2g}{PERCENT}"
    if value >= 1000.0:
        return grouped(value)
    return f"{value:#.3g}".rstrip(".") if value >= 10.0 else f"{value:.2f}"


def explained_words(share: float | None) -> str:
    """Explained share of a misfit; 100 % only where it is all of it."""
    if share is None or not math.isfinite(share):
        return "–"
    if share < 0.0:
        return f"−{percent(-share)}"
    return f"> 99.99{PERCENT}" if 0.9999 <= share < 1.0 else percent(share)


def p_words(p_value: float | None) -> str:
    """A p-value; as a power of ten where it is small."""
    if p_value is None or not math.isfinite(p_value):
        return "–"
    if p_value < 1e-99:
        return "< 10⁻⁹⁹"
    if p_value < 1e-3:
        # The format rounds before it takes the exponent: 9.6e-22 is 1·10⁻²¹.
        digit, exponent = f"{p_value:.0e}".split("e")
        return f"{digit}·10{str(int(exponent)).translate(SUPERSCRIPT)}"
    return f"{p_value:.2g}"


def grouped(value: float) -> str:
    """A large number, its digits in groups of three."""
    return f"{value:,.0f}".replace(",", "\u202f")


def typeset(text: str) -> str:
    """Plain mathematics with Greek letters and superscripts: "psi'' -= k3 |psi|^2 psi" is "ψ″ −= k3 |ψ|² ψ"."""
    text = re.sub(r"(?<![A-Za-z])(" + "|".join(_GREEK) + r")(?![A-Za-z])", lambda m: _GREEK[m[1]], text)
    text = re.sub(r"\^(-?\d+)", lambda m: m[1].translate(SUPERSCRIPT), text)
    return text.replace("''", "″").replace("'", "′").replace(" -= ", " −= ").replace(" - ", " − ")


def side(row: FailedLimit) -> str:
    """Where the failing estimates lie: "above 3 Hz", "below 1200", "outside ..."."""
    limit = row.limit
    if limit.axis or (row.below and row.above) or not (row.below or row.above):
        return f"outside {limit_words(limit)}" if math.isfinite(limit.low + limit.high) else f"not {limit_words(limit)}"
    return (
        f"below {with_unit(limit.low, limit.quantity)}"
        if row.below
        else f"above {with_unit(limit.high, limit.quantity)}"
    )


def main_cause(total: Yield, bars: Pareto) -> str:
    """The most frequently failed limit, in a few words."""
    if total.devices == 0:
        return "No devices: nothing to judge."
    if bars.failed == 0:
        return "No device failed."
    first = bars.limits[0]
    if first.failed == 0:
        return "Several limits in combination; none of them alone."
    return f"{label(first.limit.quantity).capitalize()} {side(first)}"


def cause_sentence(bars: Pareto) -> str:
    """How many failed devices the main cause explains, with the interval of its share; empty if none failed."""
    if bars.failed == 0 or bars.limits[0].failed == 0:
        return ""
    first = bars.limits[0]
    of = "the one failed device" if bars.failed == 1 else f"the {bars.failed} failed devices"
    share = percent_range(first.share.low, first.share.high)
    alone = f", {first.alone} of them no other limit" if bars.failed > 1 else ""
    return (
        f"{first.failed} of {of} break this limit ({percent(first.failed / bars.failed)}, "
        f"95{PERCENT} interval {share}){alone}."
    )


def stage_sentence(stages: Sequence[StageLoss]) -> str:
    """How many of the truly non-conforming devices were lost in fabrication and in packaging; empty without a truth."""
    if not stages:
        return ""
    whole = stages[0]
    lost = whole.fabrication + whole.packaging
    if lost == 0:
        return "According to the virtual truth, no device is lost in fabrication or packaging."
    back = f" Packaging brought {whole.recovered} back inside the limits." if whole.recovered else ""
    return (
        f"According to the virtual truth, {whole.fabrication} of {lost} lost devices were outside the limits as fabricated and "
        f"{whole.packaging} ({percent(whole.packaging / lost)}) were lost in packaging.{back}"
    )


def undecided_sentence(total: Yield, statuses: Sequence[StatusCount]) -> str:
    """Why devices are undecided; empty if none is."""
    if total.undecided == 0:
        return ""
    unsound = sum(row.devices for row in statuses if row.status != "ok")
    kinds: dict[str, int] = {}
    for row in statuses:
        if row.status != "ok":
            kinds[row.status or "no status"] = kinds.get(row.status or "no status", 0) + row.devices
    parts = [f"{n} {kind.replace('_', ' ')}" for kind, n in kinds.items()]
    close = total.undecided - unsound
    if close > 0:
        parts.insert(0, f"{close} too close to a limit")
    return (
        f"Undecided: {', '.join(parts)}. However they are decided, the yield of these devices lies between "
        f"{percent(total.bounds[0])} and {percent(total.bounds[1])}."
    )


def process_sentence(clusters: Sequence[Clustering]) -> str:
    """The yield of the process with groups as draws, by the highest level that has at least three groups."""
    counted = [one for one in clusters if one.groups >= 3 and one.interval is not None]
    if not counted:
        few = [f"{one.groups} {one.by}{'s' if one.groups > 1 else ''}" for one in clusters]
        return f"{' and '.join(few)}: too few to estimate the scatter of the process between them." if few else ""
    best = counted[-1]
    assert best.interval is not None
    return (
        f"For the process, with {best.by}s as independent draws ({best.groups} {best.by}s): "
        f"{percent_range(best.interval.low, best.interval.high)}."
    )


def listed(names: Sequence[str], last: str = "and") -> str:
    """ "a, b and c"."""
    return f"{', '.join(names[:-1])} {last} {names[-1]}" if len(names) > 1 else "".join(names)
