"""Effects of misfits: a shared effect is found from all devices together, the effect of a single device is not shared."""

import json

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from pipeline.errors import ConfigError
from pipeline.store.digest import table_digest
from pipeline.store.read import read_run
from pipeline.store.run import open_run
from reports.devices import Devices
from reports.run.lot_effects import LotEffects, needed_effects
from reports.run.page import render_run_report
from tests.stub_runs import stub_runs
from workflows.cli import call
from workflows.config import load_config
from workflows.screening.block import DeviceBlock, virtual_block
from workflows.screening.lot.device import examine_device
from workflows.screening.lot.effects import examine
from workflows.screening.lot.scope import devices_of
from workflows.screening.plan import plan, start

# Chirps of one second take a third of the time; a cubic stiffness of 8e9 is then a misfit.  They leave a friction or a weakening
# damping that is not noticed undetermined, which moves a quality factor by 6 % of the width of its limits; the gate allows 5 %.
RUN = """
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
[gate]
bias_fraction = 0.08
"""
STRONG = "[effects.cubic_stiffness]\nsize = {{ k3 = [8e9, 8e8] }}\n{who}\n"


def config_of(tmp_path, devices, text):
    path = tmp_path / "run.toml"
    path.write_text(RUN.format(devices=devices) + text)
    return load_config(path)


def examined(tmp_path, devices, text):
    """Configuration, findings and amended devices table of a run, computed in this process."""
    config = config_of(tmp_path, devices, text)
    table = virtual_block(config, DeviceBlock(0, 0, devices)).devices
    found, columns = examine(
        table, config.diagnosis, lambda requests: (examine_device((config, {}), r) for r in requests)
    )
    rows = [row | columns.get(row["device_id"], {}) for row in table.to_pylist()]
    return config, found, pa.Table.from_pylist(rows, schema=table.schema)


def page_of(results, config, found, table):
    _, store = start(plan(config), results)
    store.commit_block(0, table, None)
    store.finish("complete", {})
    return render_run_report(read_run(results), config.judged_by(), lot_effects=LotEffects.from_json(found.to_json()))


@pytest.fixture(scope="module")
def all_affected(tmp_path_factory):
    """Six devices, all with the same strong cubic stiffness."""
    return examined(tmp_path_factory.mktemp("all"), 6, STRONG.format(who=""))


def test_an_effect_of_all_devices_is_named_and_explains_their_misfit(all_affected):
    _, found, table = all_affected
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


def test_the_page_gives_the_yield_without_and_with_the_effects(tmp_path, all_affected):
    config, found, table = all_affected
    page = page_of(tmp_path / "results", config, found, table)
    section = page[page.index('id="lot-effects"') :]
    assert section.index("<td>cubic_stiffness</td>") < section.index("</table>")
    for name, column in (("without the effects", "verdict"), ("with the effects", "verdict_with_effects")):
        passed = sum(v == "pass" for v in table.column(column).to_pylist())
        row = section[section.index(f"<td>{name}</td>") :]
        assert f"<td>6</td><td>{passed}</td>" in row[: row.index("</tr>")]


def test_an_effect_of_one_device_is_not_an_effect_of_the_lot(tmp_path):
    config, found, table = examined(tmp_path, 6, STRONG.format(who='devices = ["D000003"]'))
    assert found.effects == ()
    assert found.flagged == 1
    rows = table.to_pylist()
    assert [row["missing_effect"] for row in rows] == [None, None, None, "cubic_stiffness", None, None]
    assert rows[3]["missing_effect_size"].startswith("cubic_stiffness.k3=")
    assert all(row["verdict_with_effects"] is None for row in rows)
    needed = needed_effects(Devices(table), found)
    assert [(row.device_id, row.missing) for row in needed.alone] == [("D000003", "cubic_stiffness")]
    assert (needed.unknown, needed.explained, needed.changed) == ((), 0, 0)
    section = page_of(tmp_path / "results", config, found, table).split('id="lot-effects"')[1]
    row = section[section.index("<td>D000003</td>") :]
    assert '<td class="words">cubic_stiffness<' in row[: row.index("</tr>")]


def test_an_effect_too_weak_for_a_single_device_is_found_from_all_devices(tmp_path):
    weak = "[effects.cubic_stiffness]\nsize = { k3 = [1.6e8, 0.0] }\n[diagnosis]\nsample = 10\n"
    _, found, table = examined(tmp_path, 10, weak)
    rows = table.to_pylist()
    # The gate sees the effect in the two devices that move most; the others are ok by themselves.
    assert found.flagged == 2
    assert found.ok == 8
    (effect,) = found.effects
    assert "cubic_stiffness" in (effect.effect, *effect.rivals)
    assert effect.sizes[0].mean == pytest.approx(1.6e8, abs=4.0 * effect.sizes[0].mean_sd)
    # In half of the devices alone the effect is not significant.
    assert sum(row["missing_effect"] is not None for row in rows) <= 5


def test_a_run_stopped_before_its_examination_is_resumed_to_the_same_table(tmp_path, monkeypatch, all_affected):
    stub_runs(monkeypatch)
    config, _, _ = all_affected
    config = msgspec.structs.replace(config, run=msgspec.structs.replace(config.run, devices=2, block=1))
    laid_out, results = plan(config), tmp_path / "results"
    _, store = start(laid_out, results)
    for block in laid_out.blocks:
        tables = virtual_block(config, block)
        store.commit_block(tables.index, tables.devices, tables.posterior)
    # Both devices are misfits, so the night has no yield.
    assert call(["run", "--resume", "latest", "--out", str(results), "--json"]) == 1
    table = virtual_block(config, DeviceBlock(0, 0, 2)).devices
    found, columns = examine(
        table, config.diagnosis, lambda requests: (examine_device((config, {}), r) for r in reversed(requests))
    )
    rows = [row | columns.get(row["device_id"], {}) for row in table.to_pylist()]
    assert table_digest(read_run(results).devices) == table_digest(pa.Table.from_pylist(rows, schema=table.schema))
    stored = json.loads(open_run(results).page("lot_effects.json"))
    assert stored == json.loads(found.to_json())
    assert read_run(results).manifest.summary["lot_effects"] == ["cubic_stiffness"]
    assert call(["verify", "--results", str(results)]) == 0


def test_wrong_effects_are_config_errors_before_the_first_device(tmp_path):
    for text, words in (
        ("[effects.warp_drive]\nsize = {}\n", "no such effect"),
        ("[effects.cubic_stiffness]\nsize = { k4 = [1.0, 0.0] }\n", "no such parameter"),
        ("[effects.mains_hum]\nsize = {}\n", "cannot contain"),
    ):
        with pytest.raises(ConfigError, match=words):
            plan(config_of(tmp_path, 2, text))


def test_the_affected_devices_are_a_share_of_all_and_do_not_depend_on_the_block(tmp_path):
    config = config_of(tmp_path, 40, "[effects.cubic_stiffness]\nsize = { k3 = [8e9, 8e8] }\nshare = 0.5\n")
    without = msgspec.structs.replace(config, effects={})
    rows = virtual_block(config, DeviceBlock(0, 0, 16)).devices.to_pylist()
    unaffected = virtual_block(without, DeviceBlock(0, 0, 16)).devices.to_pylist()
    affected = [a["device_id"] for a, b in zip(rows, unaffected) if a["error"] > 1.02 * b["error"]]
    assert 3 <= len(affected) <= 13
    alone = virtual_block(config, DeviceBlock(9, 5, 1)).devices.to_pylist()
    assert alone == rows[5:6]


def test_the_order_of_examination_depends_on_device_ids_only(all_affected):
    _, _, table = all_affected
    order = [device.number for device in devices_of(table)]
    again = [device.number for device in devices_of(table.slice(0, 4))]
    assert [n for n in order if n < 4] == again
    assert order != sorted(order)
