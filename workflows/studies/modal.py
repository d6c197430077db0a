"""How often noise alone produces a ladder of a modal record as long as the one that was found.

    record*  =  model of a rung at its fitted parameters + noise of that rung's own level, residues and poles
    count    =  rungs that the loop adds although nothing is missing

The simulation contains the whole loop: selection of the best candidate, pairs, successive rungs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.criticism.ladder import refine
from pipeline.criticism.problem import FitResult
from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.learning.modal.answers import modal_answers
from pipeline.learning.modal.problem import ModalProblem


def redrawn(problem: ModalProblem, fit: FitResult, rng: np.random.Generator) -> ModalRecord:
    """A record of the fitted model plus white noise on residues and poles, of the estimated or the declared level."""
    modes = problem.modes({name: value for name, (value, _) in fit.parameters.items()})
    unit, pole_unit = problem.noise(fit)
    c = modes.c + unit[:, 1] * rng.standard_normal(modes.c.shape)
    c = c + 1.0j * unit[:, 0] * rng.standard_normal(modes.c.shape)
    complex_noise = rng.standard_normal(pole_unit.size) + 1.0j * rng.standard_normal(pole_unit.size)
    poles = modes.poles + pole_unit * complex_noise
    omega = np.abs(poles)
    return replace(
        problem.record,
        frequency_hz=omega / (2.0 * np.pi),
        zeta=-poles.real / omega,
        R1=np.asarray(c.imag),
        R0=np.asarray(omega[:, None, None] * c.real),
    )


def rungs_by_chance(
    record: ModalRecord,
    effects: tuple[str, ...] = (),
    draws: int = 200,
    seed: int = 1,
    model: Model = DEFAULT_COMPARE_MODEL,
) -> tuple[int, ...]:
    """Number of rungs added beyond the true model on ``draws`` records of ``model`` with ``effects``, fitted to ``record``.

    Parameters
    ----------
    record : measured; its fit is the truth of the draws.
    effects : of the rung that serves as the truth.
    draws, seed : of the simulation.
    model : the first model of the ladder.
    """
    for effect in effects:
        model = model.with_effect(effect)
    problem = ModalProblem(record, model)
    fit = problem.fit(())
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0x30DA1,)))
    counts = []
    for _ in range(draws):
        answers = modal_answers(redrawn(problem, fit, rng), model)
        counts.append(len(refine(answers.problem, (), answers.rules).rungs) - 1)
    return tuple(counts)
