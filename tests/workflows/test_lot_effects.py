"""Misfits of a night: what is shared is found from all devices together, what one odd device has is its own."""

import json

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from pipeline.errors import ConfigError
from pipeline.store.digest import table_digest
from pipeline.store.read import read_run
from pipeline.store.run import open_run
from reports.run.lot_effects import LotEffects
from reports.run.page import render_run_report
from workflows.cli import call
from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.lot.device import examine_device
from workflows.screening.lot.effects import examine
from workflows.screening.lot.scope import devices_of
from workflows.screening.plan import plan, start

# Chirps of one second: three times cheaper than the paper's, and a cubic stiffness of 8e9 is then a misfit.
NIGHT = """
[run]
devices = {devices}
seed = 5
block = 2
[experiment]
duration_s = 1.0
silence_s = 0.5
[hum]
amplitude_v = []
[identification]
window_s = 0.8
[posterior]
stored_draws = 20
"""
STRONG = "[effects.cubic_stiffness]\nsize = {{ k3 = [8e9, 8e8] }}\n{who}\n"


def config_of(tmp_path, devices, text):
    path = tmp_path / "night.toml"
    path.write_text(NIGHT.format(devices=devices) + text)
    return load_config(path)


def night(tmp_path, devices, text):
    """The devices table of a night, and what its examination finds and writes, in this process."""
    config = config_of(tmp_path, devices, text)
    table = virtual_block(config, DeviceBlock(0, 0, devices)).devices
    found, columns = examine(
        table, config.diagnosis, lambda requests: (examine_device((config, ()), r) for r in requests)
    )
    rows = [row | columns.get(row["device_id"], {}) for row in table.to_pylist()]
    return config, found, pa.Table.from_pylist(rows, schema=table.schema)


def page_of(config, found, table):
    class Run:
        devices, posterior, manifest, config_toml = table, None, {}, ""

    return render_run_report(Run(), config.judged_by(), lot_effects=LotEffects.from_json(found.to_json()))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return night(tmp_path_factory.mktemp("all"), 6, STRONG.format(who=""))


def test_an_effect_of_all_devices_is_named_and_explains_their_misfit(whole):
    _, found, table = whole
    rows = table.to_pylist()
    (effect,) = found.effects
    assert effect.effect == "cubic_stiffness"
    assert effect.rivals == ()
    assert effect.log_p_without < np.log(1e-9)
    assert effect.low > 0.5
    assert effect.sizes[0].mean == pytest.approx(8e9, abs=4.0 * effect.sizes[0].mean_sd)
    assert found.flagged == sum(row["status"] == "misfit" for row in rows) >= 5
    for row in rows:
        assert row["status_with_effects"] == "ok"
        assert row["missing_effect"] == "cubic_stiffness"
        if row["status"] == "misfit":
            assert row["verdict"] == "undecided"
    assert sum(row["verdict_with_effects"] != "undecided" for row in rows) >= 5


def test_the_page_gives_the_yield_without_and_with_the_effects(whole):
    config, found, table = whole
    page = page_of(config, found, table)
    passed = sum(v == "pass" for v in table.column("verdict_with_effects").to_pylist())
    assert "Effects this lot needs" in page
    for words in ("cubic_stiffness", "without the effects", "with the effects", "Clopper-Pearson"):
        assert words in page
    row = page[page.index("<td>with the effects</td>") :]
    assert f"<td>6</td><td>{passed}</td>" in row[: row.index("</tr>")]


def test_one_odd_device_is_diagnosed_by_itself_and_not_promoted(tmp_path):
    config, found, table = night(tmp_path, 6, STRONG.format(who='devices = ["D000003"]'))
    assert found.effects == ()
    assert found.flagged == 1
    rows = table.to_pylist()
    assert [row["missing_effect"] for row in rows] == [None, None, None, "cubic_stiffness", None, None]
    assert rows[3]["missing_effect_size"].startswith("cubic_stiffness.k3=")
    assert all(row["verdict_with_effects"] is None for row in rows)
    page = page_of(config, found, table)
    assert "No effect is shared by the devices" in page
    assert "Misfits with an individual effect" in page


def test_an_effect_that_no_single_device_shows_is_found_from_all_together(tmp_path):
    weak = "[effects.cubic_stiffness]\nsize = { k3 = [1.6e8, 0.0] }\n[diagnosis]\nsample = 10\n"
    _, found, table = night(tmp_path, 10, weak)
    rows = table.to_pylist()
    assert found.flagged == 0
    (effect,) = found.effects
    assert "cubic_stiffness" in (effect.effect, *effect.rivals)
    assert effect.sizes[0].mean == pytest.approx(1.6e8, abs=4.0 * effect.sizes[0].mean_sd)
    # By itself a device says little: half of them not even at 3 sd.
    assert sum(row["missing_effect"] is not None for row in rows) <= 5


def test_a_run_stopped_before_its_examination_is_resumed_to_the_same_table(tmp_path, whole):
    config, _, _ = whole
    config = msgspec.structs.replace(config, run=msgspec.structs.replace(config.run, devices=3))
    laid_out, results = plan(config), tmp_path / "results"
    store = start(laid_out, results)
    for block in laid_out.blocks:
        tables = virtual_block(config, block)
        store.commit_block(tables.index, tables.devices, tables.posterior)
    assert call(["run", "--resume", "latest", "--out", str(results), "--workers", "2", "--json"]) == 0
    table = virtual_block(config, DeviceBlock(0, 0, 3)).devices
    found, columns = examine(
        table, config.diagnosis, lambda requests: (examine_device((config, ()), r) for r in reversed(requests))
    )
    rows = [row | columns.get(row["device_id"], {}) for row in table.to_pylist()]
    assert table_digest(read_run(results).devices) == table_digest(pa.Table.from_pylist(rows, schema=table.schema))
    stored = json.loads(open_run(results).page("lot_effects.json"))
    assert stored == json.loads(found.to_json())
    assert read_run(results).manifest.summary["lot_effects"] == ["cubic_stiffness"]
    assert call(["verify", "--results", str(results)]) == 0


def test_what_a_user_writes_wrongly_is_said_before_the_first_device(tmp_path):
    for text, words in (
        ("[effects.warp_drive]\nsize = {}\n", "no such effect"),
        ("[effects.cubic_stiffness]\nsize = { k4 = [1.0, 0.0] }\n", "no such parameter"),
        ("[effects.mains_hum]\nsize = {}\n", "cannot contain"),
    ):
        with pytest.raises(ConfigError, match=words):
            plan(config_of(tmp_path, 2, text))


def test_carriers_are_a_share_of_the_devices_and_do_not_depend_on_the_block(tmp_path):
    config = config_of(tmp_path, 40, "[effects.cubic_stiffness]\nsize = { k3 = [8e9, 8e8] }\nshare = 0.5\n")
    plain = replace_effects(config)
    rows = virtual_block(config, DeviceBlock(0, 0, 16)).devices.to_pylist()
    quiet = virtual_block(plain, DeviceBlock(0, 0, 16)).devices.to_pylist()
    carriers = [a["device_id"] for a, b in zip(rows, quiet) if a["error"] > 1.02 * b["error"]]
    assert 3 <= len(carriers) <= 13
    alone = virtual_block(config, DeviceBlock(9, 5, 1)).devices.to_pylist()
    assert alone == rows[5:6]


def replace_effects(config):
    return msgspec.structs.replace(config, effects={})


def test_devices_are_examined_in_an_order_that_has_nothing_to_do_with_where_they_were_made(whole):
    _, _, table = whole
    order = [device.number for device in devices_of(table)]
    again = [device.number for device in devices_of(table.slice(0, 4))]
    assert [n for n in order if n < 4] == again
    assert order != sorted(order)
