"""Scores of the effects that the model lacks, of eight devices together: K signatures, P = 14 parameters, W bins, S senses."""

from bench.device import TOGETHER, device

from pipeline.inference.screening.undetected.device import scored_devices
from pipeline.inference.screening.undetected.library import scored_effects

PART = "scores of effects"


def test_part_scores(timed):
    scorings = [one.scoring for one in device().fitted]
    signatures = len(scored_effects(True))
    (data,) = scorings[0].data
    size = scorings[0].fit.x.size + 1 + signatures
    found = timed.part(
        PART,
        lambda: scored_devices(scorings),
        {"flop": size**2 * 2 * 2 * data.band.bins.size},
        "(P + 1 + K)^2 2 S W flops: half of the products of all rows, one signature an effect",
        devices=TOGETHER,
    )
    assert not any(isinstance(one, Exception) for one in found)
