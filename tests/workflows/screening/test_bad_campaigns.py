"""One bad campaign costs its own row, whatever it is; a record that expands beyond a worker is not read at all."""

import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import MeasurementError
from pipeline.experiment.files.readers import WRITTEN, write_columns
from pipeline.experiment.files.size import check_memory, stated_values
from pipeline.store.files import file_sha256
from workflows.config import RunConfig
from workflows.screening.block import DeviceBlock
from workflows.screening.campaign_block import campaign_block
from workflows.screening.campaign_source import CampaignSource

CAMPAIGN = '[instrument]\nsample_rate_hz = 1000.0\n[[record]]\nfile = "r.parquet"\n'
ROWS = 2**20


def _expanding(path):
    """256 MiB of values in a few kilobytes: run lengths of a constant expand without bound."""
    columns = {name: pa.array(np.zeros(ROWS)) for name in ("drive1_V", "drive2_V", "sense1_V", "sense2_V")}
    with pq.ParquetWriter(path, pa.table(columns).schema, compression="zstd") as writer:
        for _ in range(8):
            writer.write_table(pa.table(columns))


def _bad(folder, kind):
    folder.mkdir()
    toml, record = folder / "campaign.toml", folder / "r.parquet"
    toml.write_text("record = " + "[" * 100_000 if kind == "brackets" else CAMPAIGN)
    match kind:
        case "expands":
            _expanding(record)
            toml.write_text(CAMPAIGN + '[[record]]\nfile = "r.parquet"\n' * 2)
        case "pipe":
            os.mkfifo(record)
        case "folder":
            record.mkdir()
        case "device":
            record.symlink_to("/dev/zero")
        case "dangling":
            record.symlink_to("nowhere")
        case "loop":
            record.symlink_to("r.parquet")
        case "forbidden":
            record.write_bytes(b"PAR1")
            record.chmod(0)
        case "pipe as campaign":
            toml.unlink()
            os.mkfifo(toml)
        case "long name":
            toml.write_text(CAMPAIGN.replace("r.parquet", "r" * 300 + ".parquet"))
        case "null":
            toml.write_text(CAMPAIGN.replace("r.parquet", "a\\u0000b"))


KINDS = (
    "brackets",
    "expands",
    "pipe",
    "folder",
    "device",
    "dangling",
    "loop",
    "forbidden",
    "pipe as campaign",
    "long name",
    "null",
)


def test_each_bad_campaign_has_its_row_with_the_reason(tmp_path):
    for kind in KINDS:
        _bad(tmp_path / kind, kind)
    big = tmp_path / "expands" / "r.parquet"
    assert big.stat().st_size < 1e6
    records = {"expands": ((str(big), file_sha256(big)[0]),) * 3}
    sources = [CampaignSource(tmp_path / kind, None, records.get(kind, ())) for kind in KINDS]
    block = DeviceBlock(0, 0, len(KINDS))
    devices = campaign_block(RunConfig(), block, sources).devices.to_pydict()
    assert devices["device_id"] == list(KINDS)
    assert set(devices["status"]) == {"fit_failed"}
    reasons = dict(zip(KINDS, devices["status_reason"], strict=True))
    assert "nested too deeply" in reasons["brackets"]
    assert "need more memory than a worker has" in reasons["expands"]
    assert "not a regular file" in reasons["pipe as campaign"]
    assert "path that no file can have" in reasons["long name"]
    assert "path that no file can have" in reasons["null"]
    assert all(reasons.values())


@pytest.mark.parametrize("form", WRITTEN)
def test_the_size_is_known_before_a_record_is_read(tmp_path, form):
    random = np.random.default_rng(1)
    columns = {name: random.standard_normal(5000) for name in ("time_s", "drive1_V", "sense1_V")}
    path = write_columns(tmp_path, "r", columns, form)
    assert 15_000 <= stated_values(path) <= 50_000
    with pytest.raises(MeasurementError, match="more memory than a worker"):
        check_memory([path] * 3, 10_000)
