"""Layouts of electrodes other than the paper's, as the two drives and two senses of its plant in a rotated frame.

    s = L psi' + c z'          L (n, 2): what each sense column measures, c (n,): its share of the up-down motion
    tau = T v,  f_z = d v      T (2, D): torque of each drive column about x and y, d (D,): its force along z

The senses of the plant are S = M_S Rot(-phi) psi' + z', its drives act with Rot(phi_D) M_D (``device.gyro``).  The angles are
chosen so that two columns with perpendicular axes stay columns: the gain of each electrode then remains a gain of one channel
(sense_imbalance, drive_imbalance).  Other columns are mixed by a 2 x n matrix:

    S = M_S Rot(-phi) L^+ s,  L^+ c = 0 where n > 2        v^ = (Rot(phi_D) M_D)^-1 T v

Differential electrodes, and three or more senses, leave out the up-down motion; the plant then has two modes.
Shapes: n sense columns, D drive columns, N samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..device.gyro import M_D, M_S
from ..errors import ConfigError
from .record import Frame, Record

Rows = Sequence[Sequence[float]]


@dataclass(frozen=True, eq=False)
class Layout:
    """The frame, and the matrices from the columns of the files to the plant's senses (2, n) and drives (2, D)."""

    frame: Frame
    sense: FloatArray
    drive: FloatArray

    def applied(self, record: Record) -> Record:
        """``record`` with the senses and drives of the plant.

        Raises
        ------
        ConfigError : the record has other numbers of columns.
        """
        for what, matrix, found in (("senses", self.sense, record.sense_v), ("drives", self.drive, record.drive_v)):
            if matrix.shape[1] != found.shape[1]:
                raise ConfigError(
                    f"[layout] {what} does not match the columns of {record.name}",
                    value=matrix.shape[1],
                    allowed=f"one row per column ({found.shape[1]})",
                    next_step="correct [layout] in campaign.toml",
                )
        return dataclasses.replace(
            record, drive_v=record.drive_v @ self.drive.T, sense_v=record.sense_v @ self.sense.T, units={}, bad=None
        )


def rotation(angle_deg: float) -> FloatArray:
    """Rot (2, 2) [1] by an angle."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return np.array([[c, -s], [s, c]])


def layout_of(senses: Rows | None, drives: Rows | None) -> Layout:
    """The layout whose columns have the rows (x, y) or (x, y, z); ``None``: as in the paper.

    Raises
    ------
    ConfigError : rows that do not span the plane, or that sense or drive the up-down motion in a way the plant cannot have.
    """
    sense = _rows(senses, "senses", np.column_stack([M_S, np.ones(2)]))
    drive = _rows(drives, "drives", np.column_stack([M_D.T, np.ones(2)]))
    angles = _angle(sense[0], M_S[0]), _angle(drive[0], M_D[:, 0])
    # What S and tau are of psi' and v in the frame of the plant.
    own_sense, own_drive = M_S @ rotation(angles[0]).T, rotation(angles[1]) @ M_D
    # Where all three motions are measured, psi' is taken without z'.
    whole = np.linalg.matrix_rank(sense) == 3
    mix = _normalised(np.asarray(own_sense @ np.linalg.pinv(sense if whole else sense[:, :2])[:2], dtype=np.float64))
    blend = _normalised(np.asarray(np.linalg.solve(own_drive, drive[:, :2].T), dtype=np.float64))
    heard = mix @ sense[:, 2]
    pushed = drive[:, 2] @ np.linalg.pinv(blend)
    updown = bool(np.max(np.abs(heard)) > 1e-9)
    fits = np.allclose(heard, heard[0]) and np.allclose(pushed, pushed[0]) and np.allclose(pushed @ blend, drive[:, 2])
    fits = fits and abs(angles[0] - angles[1]) < 1e-9
    if updown and not fits:
        raise ConfigError(
            "[layout] the electrodes take part in the up-down motion in a way that the plant cannot have",
            value={"senses": heard.tolist(), "drives": pushed.tolist()},
            allowed="equal shares of z in the two channels of the plant, or senses that do not measure z",
            next_step="add the columns of more senses, or subtract opposite electrodes",
        )
    updown = updown and bool(np.max(np.abs(pushed)) > 1e-9)
    return Layout(Frame(angles, updown), mix, blend)


def _rows(given: Rows | None, what: str, paper: FloatArray) -> FloatArray:
    """(n, 3) rows with z = 0 where it is not stated."""
    if given is None:
        return paper
    rows = np.array([[*row, 0.0][:3] for row in given if len(row) in (2, 3)], dtype=np.float64)
    if len(rows) != len(given) or len(rows) < 2 or np.linalg.matrix_rank(rows[:, :2]) < 2:
        raise ConfigError(
            f"[layout] {what} does not span the plane",
            value=[list(row) for row in given],
            allowed="a row (x, y) or (x, y, z) for each column, in two directions at least",
            next_step=f"write one row per column, such as {what} = [[1, 0], [0, 1]]",
        )
    return rows


def _angle(first: FloatArray, paper: FloatArray) -> float:
    """phi [deg] in [0, 90) that turns the axis of the paper's first electrode to that of the first column."""
    # The second electrode is perpendicular to the first, so a turn by 90 deg exchanges them.
    turn = np.rad2deg(np.arctan2(first[1], first[0]) - np.arctan2(paper[1], paper[0]))
    return float(np.round(turn % 90.0, 12) % 90.0)


def _normalised(matrix: FloatArray) -> FloatArray:
    """(2, n), scaled so that columns that stay columns keep their volts; without the rounding of zeros and ones."""
    scaled = matrix * np.sqrt(2.0) / np.linalg.norm(matrix)
    whole = np.round(scaled)
    return np.where(np.abs(scaled - whole) < 1e-12, whole, scaled) + 0.0


def rows_of(frame: Frame) -> dict[str, list[list[float]]]:
    """The rows of ``[layout]`` with which records in the channels of the plant are read as they are."""
    (sense_deg, drive_deg), z = frame.angles_deg, [1.0] if frame.updown else []
    senses, drives = (M_S @ rotation(sense_deg).T).tolist(), (rotation(drive_deg) @ M_D).T.tolist()
    return {"senses": [[*row, *z] for row in senses], "drives": [[*row, *z] for row in drives]}
