"""Do the parts of the data agree on the size of a term?

    d_g   extra size of the term in part g (a block, a level, a direction), all other parameters shared
    s_g = D' Q_g' r_g,   G_gh = D' (N_g delta_gh - N_g N_h) D,   N_g = Q_g' Q_g,   sum_g N_g = 1
    Q   = s' G^+ s  ~  chi2_rank          (Cochran's Q where nothing else is fitted)

D = R e_j are the term's columns in the coordinates of Q.  A right place with a wrong form shows as disagreement: a term that
only imitates what is missing cannot do so with one size everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .problem import FitResult
from .projection import Baseline
from .tails import log_tail

_RANK = 1e-9


@dataclass(frozen=True)
class Agreement:
    """Whether the parts of one partition agree on some parameters.

    Parameters
    ----------
    partition : "block", or the label whose values make the parts.
    statistic, dof : Cochran's Q and its degrees of freedom.
    log_p : log P(Q* > Q) when they agree.
    sizes : part -> (deviation from the common size, sd), where a single parameter was asked for.
    """

    partition: str
    statistic: float
    dof: int
    log_p: float
    sizes: Mapping[str, tuple[float, float]]


def partitions(fit: FitResult) -> dict[str, dict[str, list[int]]]:
    """Partition -> part -> blocks: by block, and by every label that has at least two values."""
    found = {"block": {f"{i}:{block.name}": [i] for i, block in enumerate(fit.blocks)}}
    for label in sorted({label for block in fit.blocks for label in block.labels}):
        parts: dict[str, list[int]] = {}
        for i, block in enumerate(fit.blocks):
            parts.setdefault(block.labels.get(label, ""), []).append(i)
        found[label] = parts
    return {name: parts for name, parts in found.items() if len(parts) > 1}


def agreement(
    base: Baseline, partition: str, parts: Mapping[str, Sequence[int]], columns: Sequence[int] | None = None
) -> Agreement:
    """Q over the parts for the given columns of the jacobian, or for all of them together."""
    p = base.upper.shape[0]
    turn = np.eye(p) if columns is None else base.upper[:, list(columns)]
    turn = turn / np.maximum(np.linalg.norm(turn, axis=0), 1e-300)
    count, k = len(parts), turn.shape[1]
    inside, spread, score = np.zeros((count, p, p)), np.zeros((count, p, p)), np.zeros((count, p))
    for g, blocks in enumerate(parts.values()):
        for b in blocks:
            q, r = base.basis[b], base.residual[b]
            inside[g] += q.T @ q
            spread[g] += q.T @ (q * base.gamma[b][:, None])
            score[g] += q.T @ r
    # s_g - N_g sum(s): the part's score with the shared parameters projected out, as a matrix on the stacked s.
    project = np.zeros((count, p, count, p))
    for g in range(count):
        project[g, :, :, :] = -inside[g][:, None, :]
        project[g, :, g, :] += np.eye(p)
    project_d = np.einsum("pk,gphq->gkhq", turn, project).reshape(count * k, count * p)
    s = project_d @ score.reshape(-1)
    gram = _sandwich(project_d, inside)
    covariance = _sandwich(project_d, spread)
    size, vector = np.linalg.eigh(gram)
    good = size > _RANK * max(float(size[-1]), 1e-300)
    rank = int(good.sum())
    inverse = (vector[:, good] / size[good]) @ vector[:, good].T
    inflation = max(1.0, float(np.trace(inverse @ covariance)) / max(rank, 1))
    statistic = float(s @ inverse @ s) / inflation
    sizes = {}
    if k == 1 and columns is not None:
        norm = float(np.linalg.norm(base.upper[:, list(columns)]))
        weight = np.array([float(turn[:, 0] @ n @ turn[:, 0]) for n in inside])
        shift = inverse @ s
        shift = shift - float(weight @ shift) / max(float(weight.sum()), 1e-300)
        sd = np.sqrt(inflation / np.maximum(weight, 1e-300)) / norm
        sizes = {part: (float(d) / norm, float(e)) for part, d, e in zip(parts, shift, sd)}
    return Agreement(partition, statistic, rank, float(log_tail(statistic, rank)) if rank else 0.0, sizes)


def _sandwich(project: FloatArray, blocks: FloatArray) -> FloatArray:
    """P blockdiag(B_g) P'."""
    count, p, _ = blocks.shape
    wide = project.reshape(-1, count, p)
    return np.asarray(np.einsum("agp,gpq,bgq->ab", wide, blocks, wide, optimize=True))
