"""The answers about a measurement of any kind; each kind loads its own part of the program."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.device.model import Model
from pipeline.experiment.files.modal_record import ModalRecord
from pipeline.experiment.tones import ToneCampaign
from pipeline.learning.campaign.answers import CampaignAnswers, campaign_answers

from ..device.measured import Measured, with_fit_records

if TYPE_CHECKING:
    from pipeline.learning.joint.answers import JointAnswers
    from pipeline.learning.modal.answers import ModalAnswers

    Answers = CampaignAnswers | ModalAnswers | JointAnswers


def answers_of(measured: Measured, model: Model) -> Answers:
    """The answers, before any fit; raises as ``compare``."""
    measured = with_fit_records(measured)
    if isinstance(measured, ToneCampaign):
        from pipeline.learning.joint.answers import joint_answers

        return joint_answers(measured, model)
    if isinstance(measured, ModalRecord):
        from pipeline.learning.modal.answers import modal_answers

        return modal_answers(measured, model)
    return campaign_answers(measured, model)
