"""A measured device of a run: its campaign folder, as it was when the run started."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from msgspec import Struct

from pipeline.errors import GyroscreenError, MeasurementError
from pipeline.experiment.campaign import read_campaign
from pipeline.experiment.files.common_tables import ConditionsTable, DeviceTable
from pipeline.experiment.files.size import check_memory
from pipeline.experiment.record import Campaign
from pipeline.store.files import file_sha256
from pipeline.toml_files import decode, read_bytes

FILE = "campaign.toml"


class _CampaignHead(Struct):
    device: DeviceTable = DeviceTable()
    conditions: ConditionsTable = ConditionsTable()


@dataclass(frozen=True)
class CampaignSource:
    """A campaign folder and what the run knows of it.

    ``text`` is the copy of its campaign.toml (``None``: it could not be read when the run started); ``records`` are the paths and
    SHA-256 of its record files.
    """

    folder: Path
    text: bytes | None = None
    records: tuple[tuple[str, str], ...] = ()

    def conditions(self) -> ConditionsTable:
        """[conditions] of its campaign.toml; empty if that cannot be read."""
        return self._head().conditions

    def device(self) -> DeviceTable:
        """[device] of its campaign.toml; empty if that cannot be read."""
        return self._head().device

    def _head(self) -> _CampaignHead:
        try:
            return decode(self.text or b"", _CampaignHead, FILE)
        except GyroscreenError:
            return _CampaignHead()

    def read(self) -> Campaign:
        """The campaign as the run knows it.

        Raises as :func:`read_campaign`, and MeasurementError where a record has changed or they do not fit into a worker.
        """
        try:
            check_memory(Path(path) for path, _ in self.records)
            return read_campaign(self.folder, self.text)
        finally:
            # After the reading, so that a change in the meantime is seen, too; it also explains why reading failed.
            self._check()

    def _check(self) -> None:
        for path, before in self.records:
            now = file_sha256(Path(path))[0]
            if now and now != before:
                raise MeasurementError(
                    f"{Path(path).name} has changed since the run started (sha256 {before[:12] or 'none'} -> {now[:12]})",
                    allowed="the records that the run was started with",
                    next_step="start a new run when the measurements are complete",
                )


def campaign_folders(path: Path) -> tuple[Path, ...]:
    """Folders directly below ``path`` that contain a campaign.toml, sorted by name."""
    return tuple(sorted(file.parent for file in path.glob(f"*/{FILE}")))


def declared_id(folder: Path) -> str:
    """The device id of a campaign; the name of its folder if campaign.toml states none or cannot be read."""
    try:
        head = decode(read_bytes(folder / FILE), _CampaignHead, FILE)
    except GyroscreenError:
        return folder.name
    return head.device.id or folder.name
