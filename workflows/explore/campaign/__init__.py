"""The interactive page of one measured device."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bokeh.document import Document

from pipeline.device.model import DEFAULT_COMPARE_MODEL, Model
from pipeline.experiment.campaign import read_measurement
from pipeline.experiment.files.modal_record import ModalRecord
from reports.words.explore_loop import campaign_lead

from .bench import CampaignBench
from .session import CampaignSession


def view(path: Path, model: Model = DEFAULT_COMPARE_MODEL) -> Callable[[Document], None]:
    """The view of the measurement at ``path``, which is read here, once; fits are made when the first session asks for them.

    Parameters
    ----------
    path : what ``gyroscreen compare`` takes.
    model : the model to start from.

    Raises
    ------
    ConfigError, MeasurementError : the measurement cannot be read.
    """
    measured = read_measurement(path)
    name = measured.name if isinstance(measured, ModalRecord) else measured.device_id
    bench = CampaignBench(measured, model)

    def fill(document: Document) -> None:
        CampaignSession(bench, document, name, campaign_lead(path.name, model.plant.kind, model.effects))

    return fill
