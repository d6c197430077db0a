"""Coefficients of the equations of motion that the independent simulator integrates."""

from __future__ import annotations

from typing import NamedTuple

from pipeline.arrays import FloatArray


class Physics(NamedTuple):
    """All coefficients of the equations of motion; zero means that an effect is absent, except for crosstalk (identity).

    stiffness [1/s^2], damping, gyroscopic [1/s] (4, 4); drive (4, 2) [1/s]; sense (2, 4), from velocities to volts;
    drive_motion, sense_motion (2, 4), from coordinates to the motion of the electrodes; crosstalk (2, 2);
    resistive [1], capacitive [s] (2, 2); filter_damping (4,) is 2 zeta omega_c and filter_square omega_c^2 of the biquads;
    hidden (2, 3) coupling, omega and zeta of the hidden modes of internal resonances 1:2 and 1:3.
    """

    stiffness: FloatArray
    damping: FloatArray
    gyroscopic: FloatArray
    drive: FloatArray
    sense: FloatArray
    drive_motion: FloatArray
    sense_motion: FloatArray
    crosstalk: FloatArray
    resistive: FloatArray
    capacitive: FloatArray
    filter_damping: FloatArray
    filter_square: float
    bias_v: float
    swing_v: float
    square_law: float
    inverse_drive_gap: float
    inverse_sense_gap: float
    stiffness_drift: float
    damping_drift: float
    gain_drift: float
    cubic: float
    quadratic_x: float
    quadratic_y: float
    drag: float
    cubic_drag: float
    film: float
    weakening: float
    friction: float
    friction_speed: float
    pickoff_time_s: float
    delay_s: float
    hysteresis: float
    hysteresis_reach: float
    stop: float
    stop_gap: float
    coupling: float
    pump: float
    pump_omega: float
    heating: float
    cooling_per_s: float
    preload: float
    preload_reach: float
    step: float
    step_s: float
    step_width_s: float
    fringe: float
    charging: float
    softened_share: float
    hidden: FloatArray
