"""Tables 1 and 2 of the paper, recomputed from its equations, beside the printed values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.identification.damping_study import largest_axis_error_deg, largest_damping_eigenvalue, rocking_motion
from reports.paper.content import NumberGroup, PrintedNumber

from .numbers import Eq14

TAU = 2.0 * np.pi
#: Split [Hz] that gives the entries of Table 1; frequencies printed to 0.1 Hz allow 1.8 to 2.0 Hz.
_WIDER_HZ = 1.95


def table1_numbers(eq14: Eq14) -> NumberGroup:
    """Table 1 (largest error of theta [deg] for a bound on the damping) and the damping in Section 5.1, recomputed."""
    f, zeta = eq14.record.frequency_hz[:2], eq14.record.zeta[:2]
    wider = np.array([f[0], f[0] + _WIDER_HZ])
    rows = []
    for bound, text in ((1, "0.024"), (2, "0.10"), (4, "0.38"), (8, "1.5"), (16, "6.3"), (32, "45")):
        ours, other = (largest_axis_error_deg(pair, float(bound)) for pair in (f, wider))
        row = PrintedNumber(f"Δθ at δ = {bound}/s", "Table 1", text, ours, None, "deg", spread=abs(ours - other))
        why = f"{other:.3g} with a split of {_WIDER_HZ} Hz, which the rounding of the frequencies allows"
        rows.append(row if row.agrees else replace(row, remark=why))
    delta = largest_damping_eigenvalue(f, zeta)
    rows.append(PrintedNumber("largest eigenvalue of C", "eq. (21)", "3.2", delta, None, "1/s"))
    worst = largest_axis_error_deg(f, delta)
    rows.append(PrintedNumber("Δθ at δ = 3.2/s", "sec. 5.1", "0.5", worst, None, "deg", relation="<"))
    c11, c22 = (2.0 * zeta * TAU * f).tolist()
    low, high = np.linalg.eigvalsh(np.array([[c11, c22], [c22, c22]]))
    rows.append(PrintedNumber("larger eigenvalue of C, c12 = c22", "sec. 5.2", "2.7909", float(high), None, "1/s"))
    rows.append(PrintedNumber("smaller eigenvalue of C, c12 = c22", "sec. 5.2", "0.4053", float(low), None, "1/s"))
    seven = "printed as “almost seven times”"
    rows.append(PrintedNumber("their ratio, about", "sec. 5.2", "7", float(high / low), None, "", seven))
    return NumberGroup(
        "Table 1: error of θ against a bound δ on the damping",
        "The largest error over all positive semidefinite C with eigenvalues up to δ, by numerical search.",
        tuple(rows),
    )


def table2_numbers(eq14: Eq14) -> NumberGroup:
    """Table 2, recomputed: tilt [deg] and axis ratio of the ellipses of the rocking modes."""
    f1, zeta = float(eq14.record.frequency_hz[0]), eq14.record.zeta[:2]
    c11, c22 = (2.0 * zeta * TAU * eq14.record.frequency_hz[:2]).tolist()
    repeated = "misprint: repeats row 2, but in row 1 both modes have equal ellipses, as printed ε2 and ratio show"
    off = "half the split multiplies ε by four, to 0.46; the print does not follow from the parameters of its row"
    printed = (
        ("1.90 Hz, √(c11 c22)", 1.90, float(np.sqrt(c11 * c22)), ("0.115", "0.163", "22.4", "15.8"), repeated),
        ("1.90 Hz, c22", 1.90, c22, ("0.115", "0.115", "22.4", "22.3"), ""),
        ("0.95 Hz, c22", 0.95, c22, ("0.477", "0.468", "11.2", "11.2"), off),
    )
    rows = []
    for title, split, c12, texts, why in printed:
        motions = [rocking_motion(f1, split + shift, zeta, c12) for shift in (0.0, -0.005, 0.005)]
        found = np.array([[*motion.tilt_deg, *motion.axis_ratio] for motion in motions])
        spread = np.abs(found - found[0]).max(axis=0)
        for k, (name, unit) in enumerate((("ε1", "deg"), ("ε2", "deg"), ("a11/a21", ""), ("a22/a12", ""))):
            ours, open_ = float(found[0, k]), float(spread[k])
            row = PrintedNumber(f"{name} at {title}", "Table 2", texts[k], ours, None, unit, spread=open_)
            remark = "" if row.agrees else "within the rounding of the split" if row.consistent else why
            rows.append(replace(row, remark=remark))
    return NumberGroup(
        "Table 2: ellipses of the rocking modes",
        "Ratio of the half axes and tilt of each mode's ellipse, recomputed.",
        tuple(rows),
    )
