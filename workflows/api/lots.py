"""A measured lot: read, compare, diagnose, refine, simulate; see :mod:`workflows.api`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pipeline.learning.lot.table import LotTable
from populations.spec import PopulationSpec, load_spec

from ..lots.loop import LotAnswers, lot_answers
from ..lots.measured import read_measured_lot
from ..lots.results import LotComparison, LotDiagnosisResult, LotRefinement
from ..lots.simulate import simulate_lot as simulated
from .loop import GivenLimits, given_limits

LotSource = LotTable | str | Path
GivenPopulation = PopulationSpec | str | Path | None
#: The name of the shipped population.
SHIPPED = "cloverleaf"


def read_lot(path: str | Path) -> LotTable:
    """The lot at ``path``: a folder with lot.toml, a table (Parquet, CSV) of result quantities, a run, or a folder of runs.

    Raises
    ------
    ConfigError : a wrong key or value in lot.toml.
    MeasurementError : the table cannot be read, lacks a column, or holds no device.
    UsageError : the folder holds no lot.

    Example
    -------
    >>> lot = gs.read_lot("mylot").lot
    >>> len(lot.device), lot.quantities, lot.held
    """
    return read_measured_lot(Path(path))


def load_population(path: str | Path) -> PopulationSpec:
    """The population of a file (TOML), or "cloverleaf" for the shipped one; ConfigError for a wrong key or value."""
    return load_spec(None if str(path) == SHIPPED and not Path(path).exists() else Path(path))


def compare_lot(
    lot: LotSource, population: GivenPopulation = None, limits: GivenLimits = None, *, seed: int = 0
) -> LotComparison:
    """How well a population explains a lot, and where it fails: error and log score, spreads with 90 % intervals, calibration.

    Parameters
    ----------
    lot : what :func:`read_lot` returned, or a path.
    population : population, population file or "cloverleaf"; by default the shipped one, or none for a lot of other quantities.
    limits : of the gyros, for the yield: limits, a file or a table; by default the shipped ones.
    seed : of the lots that are drawn for the null distribution of the tests.

    Raises
    ------
    ConfigError, MeasurementError, UsageError : as :func:`read_lot`; a population for a lot of other quantities; too few devices.

    Example
    -------
    >>> gs.compare_lot("mylot").spreads[["ratio", "low", "high"]]
    """
    return LotComparison(_computed(_answers(lot, population, limits, seed), "comparison"))


def diagnose_lot(
    lot: LotSource, population: GivenPopulation = None, limits: GivenLimits = None, *, seed: int = 0
) -> LotDiagnosisResult:
    """Which irregularity the population lacks, without refits; takes and raises what :func:`compare_lot` does.

    Example
    -------
    >>> gs.diagnose_lot("mylot", "mine.toml").candidates
    """
    return LotDiagnosisResult(_computed(_answers(lot, population, limits, seed), "diagnosis"))


def refine_lot(
    lot: LotSource, population: GivenPopulation = None, limits: GivenLimits = None, *, seed: int = 0
) -> LotRefinement:
    """The ladder: irregularities are added until none is missing, with the yield forecast of the held-out wafers.

    Takes and raises what :func:`compare_lot` does.

    Example
    -------
    >>> found = gs.refine_lot("mylot", "mine.toml")
    >>> found.table[["model", "log_score_validate", "yield_mean", "yield_measured"]]
    >>> Path("refined.toml").write_text(found.population.to_toml())
    """
    return LotRefinement(_computed(_answers(lot, population, limits, seed), "refinement"))


def simulate_lot(
    folder: str | Path, population: GivenPopulation = None, irregularities: Sequence[str] = (), *, seed: int = 1
) -> LotTable:
    """Write a virtual lot to ``folder`` and read it: 40 devices on each wafer of the population, with measurement noise.

    Parameters
    ----------
    irregularities : "NAME" or "NAME:param=value,.."; what is not given has a trial size.  truth.json lists all values.

    Raises
    ------
    UsageError : an unknown irregularity, or the folder cannot be written.
    ConfigError : an unknown parameter, or a value out of range.

    Example
    -------
    >>> lot = gs.simulate_lot("mylot", irregularities=["sidewall_tilt:edge_deg=1.5"])
    """
    simulated(Path(folder), _population(population) or load_spec(None), irregularities, seed)
    return read_lot(folder)


def _answers(lot: LotSource, population: GivenPopulation, limits: GivenLimits, seed: int) -> LotAnswers:
    table = read_lot(lot) if isinstance(lot, str | Path) else lot
    judged = given_limits(limits)
    spec = _population(population)
    return lot_answers(table, spec, seed=seed) if judged is None else lot_answers(table, spec, judged, seed)


def _population(population: GivenPopulation) -> PopulationSpec | None:
    return load_population(population) if isinstance(population, str | Path) else population


def _computed(answers: LotAnswers, name: str) -> LotAnswers:
    """The answers, after the one that was asked for was computed: errors are raised by the call, not by its result."""
    getattr(answers, name)
    return answers
