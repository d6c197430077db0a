"""Devices that several tests share."""

#: Poles, angle and gains near those of the paper's microgyro.
PAPER_LIKE = {
    "f1_hz": 534.5,
    "f2_hz": 536.4,
    "f3_hz": 590.3,
    "zeta1": 3.167e-4,
    "zeta2": 1.586e-4,
    "zeta3": 1.17e-3,
    "theta_deg": -32.0,
    "rocking_gain": 7.0,
    "updown_gain": 5.0,
    "sense_imbalance": 0.07,
    "drive_imbalance": 0.01,
}
