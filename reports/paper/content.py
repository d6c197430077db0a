"""Content of the page of the paper: printed and recomputed numbers, and the arrays of its figures.

A printed number agrees when it differs by no more than half a unit of its last digit, and is consistent when the rounding of
its inputs explains the rest of the difference.  All others carry a reason.

Shapes: N samples, F frequencies, S = 2 senses, D = 2 drives.  Units in the names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pipeline.arrays import ComplexArray, FloatArray


@dataclass(frozen=True)
class PrintedNumber:
    """One number of the paper.

    Parameters
    ----------
    name, where : the quantity, and the equation, table or section that prints it.
    printed : as printed.
    ours : computed from earlier printed values of the paper; ``None`` for an input.
    record : the same, identified from a simulated record of eq. (14); ``None`` if a record does not determine it.
    unit : of all of them.
    remark : the reason of a difference.
    relation : "=", or "<" and ">" for a printed bound.
    spread : possible change of the compared number from the rounding of its inputs, or from the noise of the record (3 sd).
    """

    name: str
    where: str
    printed: str
    ours: float | None
    record: float | None = None
    unit: str = ""
    remark: str = ""
    spread: float = 0.0
    relation: Literal["=", "<", ">"] = "="

    @property
    def value(self) -> float:
        """The printed number, in ``unit``."""
        return float(self.printed)

    @property
    def half_digit(self) -> float:
        """Half a unit of the last printed digit, in ``unit``."""
        mantissa, _, exponent = self.printed.lower().partition("e")
        decimals = len(mantissa.partition(".")[2])
        return 0.5 * 10.0 ** (int(exponent or 0) - decimals)

    @property
    def compared(self) -> float:
        """The number compared with the print: ours, or else the record's."""
        found = self.ours if self.ours is not None else self.record
        return float("nan") if found is None else found

    @property
    def deviation(self) -> float:
        """Compared minus printed, in ``unit``."""
        return self.compared - self.value

    @property
    def agrees(self) -> bool:
        """Whether the deviation is within the rounding of the print, or the bound holds."""
        if self.relation != "=":
            return self.deviation < 0.0 if self.relation == "<" else self.deviation > 0.0
        return abs(self.deviation) <= self.half_digit * (1.0 + 1e-9)

    @property
    def consistent(self) -> bool:
        """Whether the deviation is within the rounding of the print and of the inputs."""
        return self.agrees or abs(self.deviation) <= self.half_digit * (1.0 + 1e-9) + self.spread


@dataclass(frozen=True)
class NumberGroup:
    """Numbers of one section of the page; ``has_record`` where at least one also comes from a record."""

    title: str
    note: str
    rows: tuple[PrintedNumber, ...]

    @property
    def has_record(self) -> bool:
        """Whether the column of the record is shown."""
        return any(row.record is not None and row.ours is not None for row in self.rows)


@dataclass(frozen=True, eq=False)
class PaperRecord:
    """Figure 4: sense (N, 2) [V] at time (N,) [s] and its power spectral density (F, 2) [V^2/Hz] at frequency (F,)."""

    time_s: FloatArray
    sense_v: FloatArray
    frequency_hz: FloatArray
    psd: FloatArray
    line_hz: float
    resonance_hz: tuple[float, float]


@dataclass(frozen=True, eq=False)
class ResponseView:
    """Figures 5 and 6: responses (F, 2, 2) of models by name, on a wide and on a narrow grid [Hz]."""

    wide_hz: FloatArray
    wide: ComplexArray
    narrow_hz: FloatArray
    narrow: dict[str, ComplexArray]


@dataclass(frozen=True, eq=False)
class HankelView:
    """Hankel singular values (K,) of the order-40 model and of eq. (14), and the printed ones (8,).

    ``error_bound`` of six states over all frequencies, ``band_error`` around the modes; both are H-infinity norms.
    """

    model: FloatArray
    eq14: FloatArray
    printed: FloatArray
    error_bound: float
    band_error: float


@dataclass(frozen=True, eq=False)
class OrderView:
    """Against the order (n,), one set per window: theta (n, 4) [deg], split (n,) [Hz] and in-band phase change (n,) [deg]."""

    order: FloatArray
    window_s: tuple[float, ...]
    theta_deg: tuple[FloatArray, ...]
    split_hz: tuple[FloatArray, ...]
    phase_change_deg: tuple[FloatArray, ...]
    true_theta_deg: float
    true_split_hz: float


@dataclass(frozen=True, eq=False)
class StepsView:
    """Two-step route and one-step fit: |error of theta| [deg] over split (n,) [Hz], one row per damping share (m, n).

    share (m,) is c12 / sqrt(c11 c22); ``limit`` the route's error without noise; ``sd`` the posterior's own.
    """

    split_hz: FloatArray
    share: FloatArray
    route_deg: FloatArray
    limit_deg: FloatArray
    fit_deg: FloatArray
    sd_deg: FloatArray


@dataclass(frozen=True)
class ChainRow:
    """One quantity of the virtual device, in ``unit``: truth, balanced and modal truncation, one-step fit and its sd."""

    name: str
    unit: str
    truth: float
    balanced: float
    modal: float
    fit: float
    fit_sd: float


@dataclass(frozen=True)
class BiasRow:
    """One coefficient of eq. (3) to (6), in ``unit``: as printed, as corrected, and from the simulated loops."""

    equation: str
    name: str
    unit: str
    printed: float | None
    corrected: float
    loops: float
    remark: str


@dataclass(frozen=True, eq=False)
class PaperContent:
    """The whole page.

    thetas_deg : source -> the four thetas (4,) [deg].
    lattice_theta_deg : largest difference of theta between lattice and batch least squares [deg].
    lattice_s : time that the lattice took for the window [s].
    phase_deg : of the anti-alias filter at the first mode [deg].
    hinf_change : largest difference of M between the H-infinity norm and the projection, over the largest entry.
    """

    groups: dict[str, NumberGroup]
    records: PaperRecord
    responses: ResponseView
    hankel: HankelView
    orders: OrderView
    steps: StepsView
    chain: tuple[ChainRow, ...]
    thetas_deg: dict[str, FloatArray]
    biases: tuple[BiasRow, ...]
    lattice_theta_deg: float
    lattice_s: float
    phase_deg: float
    hinf_change: float

    @property
    def numbers(self) -> tuple[PrintedNumber, ...]:
        """All printed numbers, in the order of the page."""
        return tuple(row for group in self.groups.values() for row in group.rows)
