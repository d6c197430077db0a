"""The printed numbers of the paper, each beside the one that follows from what is printed before it.

Inputs are eq. (14) and (15) with the one sign put right (``configs/eq14.toml``); everything else is computed from them:
phase correction (16), Markov parameters (17), singular values, gains (18), the four thetas, Tables 1 and 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.arrays import FloatArray
from pipeline.experiment.modal_record import ModalRecord, read_modal_record
from pipeline.identification.damping_study import largest_axis_error_deg, largest_damping_eigenvalue, rocking_motion
from pipeline.identification.hankel import StateSpace, balance
from pipeline.identification.modes import ContinuousModes, hold_gain, modes_from_fractions
from pipeline.identification.phase import correct_phase_hinf
from pipeline.identification.reduction import Reduction
from pipeline.identification.route import RouteResult, identify_modal
from reports.paper_content import NumberGroup, PrintedNumber

EQ14 = Path(__file__).parent / "configs" / "eq14.toml"
RATE_HZ = 10_000.0
TAU = 2.0 * np.pi
_CHANNELS = ("S1/D1", "S1/D2", "S2/D1", "S2/D2")
_R1 = (("6.067", "-0.9687", "-21.06", "3.649"), ("-5.423", "-19.02", "-1.233", "-4.559"),
       ("21.31", "21.34", "23.09", "23.13"))  # fmt: skip
_R0 = (("7063", "-397.6", "-54670", "5861"), ("-5408", "-50450", "-727.3", "-9474"),
       ("64680", "-64740", "69500", "69570"))  # fmt: skip
_M = (("6.240", "-0.8787", "-26.52", "4.014"), ("-5.425", "-24.10", "1.153", "-5.355"),
      ("27.49", "27.53", "29.70", "29.74"))  # fmt: skip
HANKEL = ("15.2", "15.2", "6.75", "6.75", "3.49", "3.48", "0.0652", "0.0651")
THETAS = ("-30.76", "-36.44", "-33.40", "-32.31")
_ROUNDED = "rounding of the inputs: eq. (14) and (15) are printed to four digits"


@dataclass(frozen=True, eq=False)
class Eq14:
    """The printed device: the record, its modes, and the route from them."""

    record: ModalRecord
    modes: ContinuousModes
    route: RouteResult


def printed_device() -> Eq14:
    """Eq. (14) and (15)."""
    record = read_modal_record(EQ14)
    modes = modes_from_fractions(record.frequency_hz, record.zeta, record.R1, record.R0)
    return Eq14(record, modes, identify_modal(record))


def hankel_of(modes: ContinuousModes) -> FloatArray:
    """Hankel singular values of continuous modes behind a zero-order hold at 10 kHz."""
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
    return balance(StateSpace(a, b, c, np.zeros((senses, drives)))).hankel


def _matrix(
    name: str, where: str, printed: Sequence[str], ours: FloatArray | None, record: FloatArray, remarks: dict[int, str]
) -> list[PrintedNumber]:
    flat = None if ours is None else ours.ravel()
    return [
        PrintedNumber(
            f"{name}, {_CHANNELS[k]}",
            where,
            text,
            None if flat is None else float(flat[k]),
            float(record.ravel()[k]),
            remark=remarks.get(k, ""),
        )
        for k, text in enumerate(printed)
    ]


def model_numbers(found: RouteResult) -> NumberGroup:
    """Eq. (14) and (15) identified again from a simulated record of them."""
    filtered = found.filtered
    f, zeta = filtered.frequency_hz, filtered.zeta
    by_print = "identified again, with the noise of a 60 dB record"
    rows = []
    for k, (text, damping) in enumerate(zip(("534.5", "536.4", "590.3"), ("3.167e-4", "1.586e-4", "11.70e-4"))):
        rows.append(PrintedNumber(f"frequency of mode {k + 1}", "eq. (15)", text, None, float(f[k]), "Hz"))
        rows.append(PrintedNumber(f"damping ratio of mode {k + 1}", "eq. (15)", damping, None, float(zeta[k])))
    sign = "sign misprinted: +64740; with −64740 the up-down mode would not move all electrodes alike"
    for k in range(3):
        rows += _matrix(f"R1 of mode {k + 1}", "eq. (14)", _R1[k], None, filtered.R1[k], {})
        rows += _matrix(f"R0 of mode {k + 1}", "eq. (14)", _R0[k], None, filtered.R0[k], {1: sign} if k == 2 else {})
    with_why = tuple(row if row.agrees or row.remark else _because(row, by_print) for row in rows)
    return NumberGroup(
        "The six-state model, eq. (14) and (15)",
        "A record was simulated from eq. (14) itself (the paper's chirps, 60 dB, hum, 16 bits) and identified by the paper's "
        "chain: bandpass, 2 s window, lattice of order 40, three modes, zero-order hold inverted.",
        with_why,
    )


def _because(row: PrintedNumber, remark: str) -> PrintedNumber:
    return PrintedNumber(row.name, row.where, row.printed, row.ours, row.record, row.unit, remark)


def frequency_numbers(found: RouteResult) -> NumberGroup:
    """What Section 4.1 says of the frequencies, and the settings that were taken over."""
    instrument = "another instrument on the real device: cannot be computed; the print itself is this far from eq. (15)"
    f = (534.5, 536.4, 590.3)
    rows = [
        PrintedNumber(f"vibrometer, mode {k + 1}", "sec. 4.1", text, f[k], None, "Hz", instrument)
        for k, text in enumerate(("534.6", "536.5", "590.0"))
    ]
    rows.append(PrintedNumber("frequency split", "Table 2", "1.90", f[1] - f[0], found.arx_split_hz, "Hz"))
    share = 100.0 * (f[1] - f[0]) / f[0]
    rows.append(
        PrintedNumber("split, bound", "sec. 4.2", "0.4", share, None, "%", "printed as “less than 0.4 %”: it is")
    )
    return NumberGroup("Frequencies", "", tuple(rows))


def hankel_numbers(eq14: FloatArray, reduction: Reduction) -> NumberGroup:
    """Hankel singular values: of eq. (14), and of the order-40 model of the record."""
    inconsistent = (
        "does not follow from the printed M and ζ: a light mode has |M|₂/(4ζω), that is 11.8, 6.48, 3.30 here"
    )
    rest = "what of the record is no mode: noise, hum and distortion of that record, not a property of the device"
    rows = tuple(
        PrintedNumber(
            f"Hankel value {k + 1}",
            "sec. 4.1",
            text,
            float(eq14[k]) if k < 6 else None,
            float(reduction.hankel[k]),
            remark=inconsistent if k < 6 else rest,
        )
        for k, text in enumerate(HANKEL)
    )
    return NumberGroup("Hankel singular values", "", rows)


def markov_numbers(eq14: Eq14, found: RouteResult) -> NumberGroup:
    """M1 to M3 by the H-infinity phase correction (16)."""
    ours = correct_phase_hinf(eq14.modes, eq14.record.antialias)
    rows: list[PrintedNumber] = []
    sign = "sign misprinted: eq. (14) has −1.233 s − 727.3 there, and only −1.153 gives the printed singular values"
    for k in range(3):
        rows += _matrix(f"M{k + 1}", "eq. (17)", _M[k], ours[k], found.M[k], {2: sign} if k == 1 else {})
    return NumberGroup(
        "First Markov parameters, eq. (16) and (17)",
        "",
        tuple(row if row.agrees or row.remark else _because(row, _ROUNDED) for row in rows),
    )


def gain_numbers(eq14: Eq14, found: RouteResult) -> NumberGroup:
    """SVD of M3, the gains, and the rank-one tests of the rocking modes."""
    pair = []
    for M, gains in ((eq14.route.M, eq14.route.gains), (found.M, found.gains)):
        u, size, vt = np.linalg.svd(M[2])
        sense, drive = np.abs(u[:, 0]), np.abs(vt[0])
        scale = 1.0 / (sense.mean() * drive.mean())
        pair.append((sense, drive, size, scale, gains))
    (sense, drive, size, scale, _), (sense_r, drive_r, size_r, scale_r, _) = pair
    digits = "M3 is printed to four digits, which fixes its second singular value only to 0.003"
    rows = [
        PrintedNumber("K_S1", "sec. 4.2", "0.6793", sense[0], sense_r[0]),
        PrintedNumber("K_S2", "sec. 4.2", "0.7338", sense[1], sense_r[1]),
        PrintedNumber("K_D1", "sec. 4.2", "0.7066", drive[0], drive_r[0]),
        PrintedNumber("K_D2", "sec. 4.2", "0.7076", drive[1], drive_r[1]),
        PrintedNumber("first singular value of M3", "sec. 4.2", "57.27", size[0], size_r[0]),
        PrintedNumber("second singular value of M3", "sec. 4.2", "1.370e-5", size[1], size_r[1], remark=digits),
        PrintedNumber(
            "condition of M3, at least", "sec. 4.2", "4e6", size[0] / size[1], size_r[0] / size_r[1],
            remark=digits + "; no measurement of a device reaches 4·10⁶",
        ),
        PrintedNumber(
            "sense gain imbalance", "sec. 4.2", "7.4", 100.0 * (1.0 - sense[0] / sense[1]),
            100.0 * (1.0 - sense_r[0] / sense_r[1]), "%",
        ),
    ]  # fmt: skip
    values = (("26.6797", "0.0656"), ("26.2276", "0.0490"))
    for k, texts in enumerate(values):
        ours, theirs = eq14.route.axes.singular_values[k], found.axes.singular_values[k]
        for j, text in enumerate(texts):
            which = ("first", "second")[j]
            rows.append(
                PrintedNumber(
                    f"{which} singular value of M̃{k + 1} · ν_S ν_D",
                    "sec. 4.2",
                    text,
                    ours[j] * scale,
                    theirs[j] * scale_r,
                )
            )
        rows.append(
            PrintedNumber(
                f"condition of M̃{k + 1}, above", "sec. 4.2", "400", eq14.route.axes.conditions[k],
                found.axes.conditions[k], remark="printed as “greater than 400”: it is",
            )
        )  # fmt: skip
    return NumberGroup(
        "Gains and rank-one tests",
        "",
        tuple(row if row.agrees or row.remark else _because(row, _ROUNDED) for row in rows),
    )


def theta_numbers(eq14: Eq14, found: RouteResult) -> NumberGroup:
    """The four estimates of theta."""
    ours, record = eq14.route.axes.theta_deg, found.axes.theta_deg
    rows = [
        PrintedNumber(f"θ from {name}", "sec. 4.2", text, float(ours[k]), float(record[k]), "deg")
        for k, (name, text) in enumerate(zip(("u1", "v1", "u2", "v2"), THETAS))
    ]
    spread, spread_r = (float(np.ptp(t)) for t in (ours, record))
    less = "printed as “less than 6 degrees”: it is"
    about = "printed as “about 1 degree”: it is"
    rows.append(PrintedNumber("largest discrepancy", "sec. 4.2", "6", spread, spread_r, "deg", less))
    near, near_r = (float(abs(t[2] - t[3])) for t in (ours, record))
    rows.append(PrintedNumber("discrepancy of mode 2", "sec. 4.2", "1", near, near_r, "deg", about))
    return NumberGroup(
        "The four estimates of θ",
        "",
        tuple(row if row.agrees or row.remark else _because(row, _ROUNDED) for row in rows),
    )


def table1_numbers(eq14: Eq14) -> NumberGroup:
    """Table 1 and what Section 5.1 says of the damping."""
    f, zeta = eq14.record.frequency_hz[:2], eq14.record.zeta[:2]
    wider = np.array([f[0], f[0] + 1.95])
    rows = []
    for bound, text in ((1, "0.024"), (2, "0.10"), (4, "0.38"), (8, "1.5"), (16, "6.3"), (32, "45")):
        other = largest_axis_error_deg(wider, float(bound))
        why = f"follows from a split of 1.95 Hz ({other:.3g}), which rounds like the printed frequencies may"
        ours = largest_axis_error_deg(f, float(bound))
        row = PrintedNumber(f"Δθ at δ = {bound}/s", "Table 1", text, ours, None, "deg")
        rows.append(row if row.agrees else _because(row, why))
    delta = largest_damping_eigenvalue(f, zeta)
    rows.append(PrintedNumber("largest eigenvalue of C", "eq. (21)", "3.2", delta, None, "1/s"))
    half = "printed as “less than half a degree”: it is"
    worst = largest_axis_error_deg(f, delta)
    rows.append(PrintedNumber("Δθ at δ = 3.2/s, below", "sec. 5.1", "0.5", worst, None, "deg", half))
    c11, c22 = (2.0 * zeta * TAU * f).tolist()
    low, high = np.linalg.eigvalsh(np.array([[c11, c22], [c22, c22]]))
    rows.append(PrintedNumber("larger eigenvalue of C at c12 = c22", "sec. 5.2", "2.7909", float(high), None, "1/s"))
    rows.append(PrintedNumber("smaller eigenvalue of C at c12 = c22", "sec. 5.2", "0.4053", float(low), None, "1/s"))
    seven = "printed as “almost seven times”: it is"
    rows.append(PrintedNumber("their ratio", "sec. 5.2", "7", float(high / low), None, "", seven))
    return NumberGroup(
        "Table 1: error of θ against a bound δ on the damping",
        "The largest error over all positive semidefinite C with eigenvalues up to δ, searched from scratch.",
        tuple(row if row.agrees or row.remark else _because(row, _ROUNDED) for row in rows),
    )


def table2_numbers(eq14: Eq14) -> NumberGroup:
    """Table 2: ellipses of the rocking modes."""
    f, zeta = eq14.record.frequency_hz[:2], eq14.record.zeta[:2]
    c11, c22 = (2.0 * zeta * TAU * f).tolist()
    repeated = "the print repeats row 2; row 1 is symmetric in the modes, as its own ε2 and ratio of mode 2 show"
    off = "half the split quadruples ε: 4 × 0.115 = 0.46; the print does not follow from its own parameters"
    printed = (
        ("1.90 Hz, √(c11 c22)", 1.90, float(np.sqrt(c11 * c22)), ("0.115", "0.163", "22.4", "15.8"), repeated),
        ("1.90 Hz, c22", 1.90, c22, ("0.115", "0.115", "22.4", "22.3"), ""),
        ("0.95 Hz, c22", 0.95, c22, ("0.477", "0.468", "11.2", "11.2"), off),
    )
    rows = []
    for title, split, c12, texts, why in printed:
        motion = rocking_motion(float(f[0]), split, zeta, c12)
        found = [*motion.tilt_deg, *motion.axis_ratio]
        for name, unit, text, ours in zip(("ε1", "ε2", "a11/a21", "a22/a12"), ("deg", "deg", "", ""), texts, found):
            row = PrintedNumber(f"{name} at {title}", "Table 2", text, float(ours), None, unit)
            rows.append(row if row.agrees else _because(row, why or _ROUNDED))
    return NumberGroup(
        "Table 2: ellipses of the rocking modes",
        "Half axes and turn of each mode's ellipse, from scratch.",
        tuple(rows),
    )
