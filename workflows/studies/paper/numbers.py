"""The printed numbers of the paper, each beside the one computed from the numbers printed before it.

Inputs are eq. (14) and (15) with the misprinted sign corrected (``configs/eq14.toml``); everything else is computed from them:
phase correction (16), Markov parameters (17), singular values, gains (18), the four thetas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.experiment.files.modal_record import ModalRecord, read_modal_record
from pipeline.identification.axes import axes, gains_from_updown
from pipeline.identification.hankel import DiscreteStateSpace, balance
from pipeline.identification.modes import ContinuousModes, hold_gain, modes_from_fractions
from pipeline.identification.phase import correct_phase_hinf
from pipeline.identification.reduction import Reduction
from pipeline.identification.route import RouteResult, identify_modal, route_from_modes
from reports.paper.content import NumberGroup, PrintedNumber

EQ14 = Path(__file__).parents[2] / "configs" / "eq14.toml"
RATE_HZ = 10_000.0
_CHANNELS = ("S1/D1", "S1/D2", "S2/D1", "S2/D2")
_R1 = (("6.067", "-0.9687", "-21.06", "3.649"), ("-5.423", "-19.02", "-1.233", "-4.559"),
       ("21.31", "21.34", "23.09", "23.13"))  # fmt: skip
_R0 = (("7063", "-397.6", "-54670", "5861"), ("-5408", "-50450", "-727.3", "-9474"),
       ("64680", "-64740", "69500", "69570"))  # fmt: skip
_M = (("6.240", "-0.8787", "-26.52", "4.014"), ("-5.425", "-24.10", "1.153", "-5.355"),
      ("27.49", "27.53", "29.70", "29.74"))  # fmt: skip
HANKEL = ("15.2", "15.2", "6.75", "6.75", "3.49", "3.48", "0.0652", "0.0651")
THETAS = ("-30.76", "-36.44", "-33.40", "-32.31")
_ROUNDED = "within the rounding of eq. (14) and (15)"
_NOISE = "within the noise of the record (3 sd)"


Relation = Literal["=", "<", ">"]


@dataclass(frozen=True, eq=False)
class Eq14:
    """The printed device: the record, its modes, and the route from them."""

    record: ModalRecord
    modes: ContinuousModes
    route: RouteResult


def printed_device() -> Eq14:
    """The device of eq. (14) and (15), from ``configs/eq14.toml``."""
    record = read_modal_record(EQ14)
    modes = modes_from_fractions(record.frequency_hz, record.zeta, record.R1, record.R0)
    return Eq14(record, modes, identify_modal(record))


def hankel_of(modes: ContinuousModes) -> FloatArray:
    """Hankel singular values (K,), largest first, of continuous modes behind a zero-order hold at 10 kHz."""
    z = np.exp(modes.poles / RATE_HZ)
    residues = modes.residues * hold_gain(modes.poles, RATE_HZ, "zoh")[:, None, None]
    count, senses, drives = residues.shape
    a = np.zeros((2 * drives * count,) * 2)
    b = np.zeros((2 * drives * count, drives))
    c = np.zeros((senses, 2 * drives * count))
    identity = np.eye(drives)
    for k in range(count):
        # x+ = z x + u, y = 2 Re(R x), with real and imaginary part of x (D,) as states.
        part = slice(2 * drives * k, 2 * drives * (k + 1))
        turn = np.array([[z[k].real, -z[k].imag], [z[k].imag, z[k].real]])
        a[part, part] = np.kron(turn, identity)
        b[part] = np.concatenate([identity, np.zeros((drives, drives))])
        c[:, part] = 2.0 * np.concatenate([residues[k].real, -residues[k].imag], axis=1)
    return balance(DiscreteStateSpace(a, b, c, np.zeros((senses, drives)))).hankel


def derived(route: RouteResult, M: FloatArray | None = None) -> dict[str, float]:
    """Everything that Section 4 prints of a device, by name, in the printed unit; ``M`` (3, 2, 2) replaces the route's."""
    M = route.M if M is None else M
    out: dict[str, float] = {}
    filtered = route.filtered
    for k in range(3):
        out[f"frequency of mode {k + 1}"] = float(filtered.frequency_hz[k])
        out[f"damping ratio of mode {k + 1}"] = float(filtered.zeta[k])
        for name, matrix in (("R1", filtered.R1[k]), ("R0", filtered.R0[k])):
            out |= {f"{name} of mode {k + 1}, {c}": float(v) for c, v in zip(_CHANNELS, matrix.ravel())}
        out |= {f"M{k + 1}, {c}": float(v) for c, v in zip(_CHANNELS, M[k].ravel())}
    u, size, vt = np.linalg.svd(M[2])
    sense, drive = np.abs(u[:, 0]), np.abs(vt[0])
    out |= {"K_S1": sense[0], "K_S2": sense[1], "K_D1": drive[0], "K_D2": drive[1]}
    out |= {"σ1 of M3": size[0], "σ2 of M3": size[1], "condition of M3": size[0] / size[1]}
    out["sense gain imbalance"] = 100.0 * (1.0 - sense[0] / sense[1])
    found = axes(M[0], M[1], gains_from_updown(M[2]))
    for k, (first, second) in enumerate(found.singular_values):
        # The paper takes singular vectors of unit length for the gains, we a mean gain of one.
        scale = 1.0 / (sense.mean() * drive.mean())
        out[f"σ1 of M̃{k + 1} · ν_S ν_D"], out[f"σ2 of M̃{k + 1} · ν_S ν_D"] = first * scale, second * scale
        out[f"condition of M̃{k + 1}"] = first / second
    for name, angle in zip(("u1", "v1", "u2", "v2"), found.theta_deg):
        out[f"θ from {name}"] = angle
        # u1, v1 = (cos, sin) theta;  u2, v2 = (-sin, cos) theta
        along, across = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        out |= (
            {f"{name}, x": along, f"{name}, y": across}
            if name[1] == "1"
            else {f"{name}, x": -across, f"{name}, y": along}
        )
    out["largest discrepancy"] = float(np.ptp(found.theta_deg))
    out["discrepancy of mode 2, about"] = float(abs(found.theta_deg[2] - found.theta_deg[3]))
    return {name: float(value) for name, value in out.items()}


def rounding_spread(eq14: Eq14, draws: int = 300) -> dict[str, float]:
    """Largest change of each derived number while the inputs vary at random within half a unit of their last digit."""
    random = np.random.default_rng(0)
    record = eq14.record
    centre = derived(eq14.route)
    spread = dict.fromkeys(centre, 0.0)
    for _ in range(draws):
        f = record.frequency_hz + random.uniform(-0.05, 0.05, 3)
        zeta = record.zeta + random.uniform(-1.0, 1.0, 3) * np.array([0.5e-7, 0.5e-7, 0.5e-6])
        r1, r0 = (_within(printed, random) for printed in (_R1, _R0))
        r0[2, 0, 1] *= -1.0
        moved = derived(route_from_modes(modes_from_fractions(f, zeta, r1, r0), record.antialias))
        spread = {name: max(spread[name], abs(moved[name] - centre[name])) for name in centre}
    return spread


def _within(printed: Sequence[Sequence[str]], random: np.random.Generator) -> FloatArray:
    numbers = [[PrintedNumber("", "", text, None) for text in row] for row in printed]
    drawn = [[n.value + n.half_digit * random.uniform(-1.0, 1.0) for n in row] for row in numbers]
    return np.array(drawn).reshape(3, 2, 2)


@dataclass(frozen=True, eq=False)
class Sources:
    """Numbers by name, from eq. (14) and from a record of it, and how much each may change by rounding and by noise."""

    eq14: dict[str, float]
    record: dict[str, float]
    rounding: dict[str, float]
    noise: dict[str, float]

    def row(
        self, name: str, where: str, printed: str, unit: str = "", remark: str = "", relation: Relation = "="
    ) -> PrintedNumber:
        """A printed number beside the one computed from eq. (14) and the one identified from the record."""
        row = PrintedNumber(
            name, where, printed, self.eq14[name], self.record[name], unit, remark, self.rounding[name], relation
        )
        return row if row.agrees or remark or not row.consistent else replace(row, remark=_ROUNDED)

    def again(self, name: str, where: str, printed: str, unit: str = "", remark: str = "") -> PrintedNumber:
        """A printed number of eq. (14) or (15) itself, beside the one identified from the record."""
        row = PrintedNumber(name, where, printed, None, self.record[name], unit, remark, self.noise[name])
        return row if row.agrees or remark or not row.consistent else replace(row, remark=_NOISE)


def sources(eq14: Eq14, found: Sequence[RouteResult]) -> Sources:
    """Numbers from eq. (14), and from records of it that differ in their noise; those of the first record are shown."""
    each = [derived(route) for route in found]
    sd = {name: float(np.std([one[name] for one in each], ddof=1)) for name in each[0]}
    hinf = derived(eq14.route, correct_phase_hinf(eq14.modes, eq14.record.antialias))
    return Sources(hinf, each[0], rounding_spread(eq14), {name: 3.0 * value for name, value in sd.items()})


def model_numbers(of: Sources) -> NumberGroup:
    """Eq. (14) and (15), and their identification from a simulated record."""
    rows = []
    for k, (text, damping) in enumerate(zip(("534.5", "536.4", "590.3"), ("3.167e-4", "1.586e-4", "11.70e-4"))):
        rows.append(of.again(f"frequency of mode {k + 1}", "eq. (15)", text, "Hz"))
        rows.append(of.again(f"damping ratio of mode {k + 1}", "eq. (15)", damping))
    sign = "sign misprint: should be +64740; with −64740 the up-down mode would not move all electrodes in phase"
    for name, printed in (("R1", _R1), ("R0", _R0)):
        for k in range(3):
            for j, channel in enumerate(_CHANNELS):
                why = sign if (name, k, j) == ("R0", 2, 1) else ""
                rows.append(of.again(f"{name} of mode {k + 1}, {channel}", "eq. (14)", printed[k][j], "", why))
    return NumberGroup(
        "The six-state model, eq. (14) and (15)",
        "A record was simulated from eq. (14) itself (the paper's chirps, 60 dB, hum, 16 bits) and identified by the "
        "paper's chain: bandpass, 2 s window, lattice of order 40, three modes, zero-order hold inverted.",
        tuple(rows),
    )


def frequency_numbers(found: RouteResult) -> NumberGroup:
    """Section 4.1: frequencies [Hz] by the vibrometer, the split, and the range of the second harmonics."""
    instrument = "measured by another instrument, so it cannot be computed; shown beside it is eq. (15)"
    f = (534.5, 536.4, 590.3)
    rows = [
        PrintedNumber(f"vibrometer, mode {k + 1}", "sec. 4.1", text, f[k], None, "Hz", "as above" if k else instrument)
        for k, text in enumerate(("534.6", "536.5", "590.0"))
    ]
    rows.append(PrintedNumber("frequency split", "Table 2", "1.90", f[1] - f[0], found.arx_split_hz, "Hz"))
    share = 100.0 * (f[1] - f[0]) / f[0]
    rows.append(PrintedNumber("split over frequency", "sec. 4.2", "0.4", share, None, "%", relation="<"))
    rows.append(PrintedNumber("second harmonics, from", "sec. 4.1", "1000", 2.0 * f[0], None, "Hz", relation=">"))
    rows.append(PrintedNumber("second harmonics, up to", "sec. 4.1", "1200", 2.0 * f[2], None, "Hz", relation="<"))
    return NumberGroup("Frequencies", "", tuple(rows))


def hankel_numbers(eq14: FloatArray, reduction: Reduction) -> NumberGroup:
    """Hankel singular values as printed, of eq. (14) ``eq14`` (K,), and of the order-40 model of the record."""
    first = "does not follow from the printed M and ζ: a lightly damped mode has |M|₂/(4ζω), here 11.8, 6.48 and 3.30"
    rest = "from the part of the record that is not a mode (noise, hum): a property of the record, not of the device"
    rows = tuple(
        PrintedNumber(
            f"Hankel value {k + 1}",
            "sec. 4.1",
            text,
            float(eq14[k]) if k < 6 else None,
            float(reduction.hankel[k]),
            remark=first if k == 0 else "as above" if k < 6 else rest if k == 6 else "as above",
        )
        for k, text in enumerate(HANKEL)
    )
    return NumberGroup("Hankel singular values", "", rows)


def markov_numbers(of: Sources) -> NumberGroup:
    """M1 to M3 by the H-infinity phase correction, eq. (16) and (17)."""
    sign = "sign misprint: eq. (14) has −1.233 s − 727.3 there, and only −1.153 gives the printed singular values"
    rows = tuple(
        of.row(f"M{k + 1}, {channel}", "eq. (17)", _M[k][j], "", sign if (k, j) == (1, 2) else "")
        for k in range(3)
        for j, channel in enumerate(_CHANNELS)
    )
    return NumberGroup("First Markov parameters, eq. (16) and (17)", "", rows)


def gain_numbers(of: Sources) -> NumberGroup:
    """SVD of M3, the gains, and the rank-one tests of the rocking modes."""
    digits = (
        "four digits of M3 determine it only to 0.003; from a record it is as small as printed for any device, because "
    )
    digits += "the residue of an ARX pole has rank one by construction"
    rows = (
        of.row("K_S1", "sec. 4.2", "0.6793"),
        of.row("K_S2", "sec. 4.2", "0.7338"),
        of.row("K_D1", "sec. 4.2", "0.7066"),
        of.row("K_D2", "sec. 4.2", "0.7076"),
        of.row("sense gain imbalance", "sec. 4.2", "7.4", "%"),
        of.row("σ1 of M3", "sec. 4.2", "57.27"),
        of.row("σ2 of M3", "sec. 4.2", "1.370e-5", "", digits),
        of.row("condition of M3", "sec. 4.2", "4e6", "", "as above", ">"),
        of.row("σ1 of M̃1 · ν_S ν_D", "sec. 4.2", "26.6797"),
        of.row("σ2 of M̃1 · ν_S ν_D", "sec. 4.2", "0.0656"),
        of.row("condition of M̃1", "sec. 4.2", "400", "", "", ">"),
        of.row("σ1 of M̃2 · ν_S ν_D", "sec. 4.2", "26.2276"),
        of.row("σ2 of M̃2 · ν_S ν_D", "sec. 4.2", "0.0490"),
        of.row("condition of M̃2", "sec. 4.2", "400", "", "", ">"),
    )
    vectors = (
        ("u1", "0.8593", "-0.5114"),
        ("v1", "0.8045", "-0.5940"),
        ("u2", "0.5505", "0.8349"),
        ("v2", "0.5346", "0.8451"),
    )
    turned = tuple(of.row(f"{n}, {axis}", "sec. 4.2", text) for n, *pair in vectors for axis, text in zip("xy", pair))
    return NumberGroup("Gains and rank-one tests (σ: singular values; u, v: singular vectors)", "", rows + turned)


def theta_numbers(of: Sources) -> NumberGroup:
    """The four estimates of theta [deg] and their discrepancies."""
    four = [of.row(f"θ from {n}", "sec. 4.2", text, "deg") for n, text in zip(("u1", "v1", "u2", "v2"), THETAS)]
    about = "printed as “about 1 degree”"
    four.append(of.row("largest discrepancy", "sec. 4.2", "6", "deg", "", "<"))
    four.append(of.row("discrepancy of mode 2, about", "sec. 4.2", "1", "deg", about))
    return NumberGroup("The four estimates of θ", "", tuple(four))
