"""A device as a function of latent normals: the distribution of a seeded draw, nothing to edit for a new irregularity."""

from __future__ import annotations

import pickle
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.stats import kstest

from pipeline.errors import ConfigError, UsageError
from populations.draw import draw
from populations.latent import draw_latent, latent_space, true_latent
from populations.layout import die_centres
from populations.numbers import field_factor
from populations.spec import load_spec

SPEC = load_spec()
SPACE = latent_space(SPEC)


def normals(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, SPACE.dimension))


def test_a_device_is_a_function_of_its_own_latent_normals() -> None:
    z = normals(50, 1)
    batch = draw_latent(SPEC, SPACE, z, 1)
    single = draw_latent(SPEC, SPACE, z[7:8], 1)
    for name, values in batch.true.items():
        assert values[7] == single.true[name][0]
    assert len(set(batch.wafer)) == 50
    again = draw_latent(SPEC, pickle.loads(pickle.dumps(SPACE)), z, 1)
    assert all(np.array_equal(values, again.true[name]) for name, values in batch.true.items())


def test_true_values_alone_are_those_of_the_whole_draw_bit_for_bit() -> None:
    z = normals(50, 2)
    whole, alone = draw_latent(SPEC, SPACE, z, 1).true, true_latent(SPEC, SPACE, z, 1)
    assert whole.keys() == alone.keys()
    assert all(np.array_equal(values, alone[name]) for name, values in whole.items())


def test_marginals_are_those_of_devices_of_seeded_lots() -> None:
    """One device per batch of ten wafers, so that the devices of the reference are independent, too.

    The dies of the reference are drawn at random; the layout of a batch visits them in a fixed order.
    """
    dies = len(die_centres(SPEC.wafer))
    random = np.random.default_rng(5)
    numbers = 10 * dies * np.arange(600) + random.integers(0, 10 * dies, 600)
    seeded = [draw(SPEC, 4, int(n), 1) for n in numbers]
    latent = draw_latent(SPEC, SPACE, normals(20_000, 2), 4)
    for stage in ("true", "fab"):
        for name in ("f1_hz", "split_hz", "zeta1", "zeta3", "c12_per_s", "rocking_gain", "drive_imbalance"):
            own = np.array([getattr(one, stage)[name][0] for one in seeded])
            # 14 comparisons: 1e-4 each is a false alarm of 0.14 %.
            assert kstest(own, getattr(latent, stage)[name]).pvalue > 1e-4, (stage, name)


def test_every_die_of_the_wafer_is_equally_probable() -> None:
    drawn = draw_latent(SPEC, SPACE, normals(40_000, 3), 1)
    places = np.stack([drawn.die_x_mm, drawn.die_y_mm], axis=1)
    _, counts = np.unique(places, axis=0, return_counts=True)
    dies = len(die_centres(SPEC.wafer))
    assert counts.size == dies
    expected = 40_000 / dies
    chi2 = float(np.sum((counts - expected) ** 2 / expected))
    assert abs(chi2 - (dies - 1)) < 5.0 * np.sqrt(2.0 * (dies - 1))


FIELDS = """
from populations.irregularity import Change, Irregularity, Parameter

def act(p, site):
    near, far = site.field(5.0), site.field(40.0)
    leak = site.uniform("die") < 0.5
    return Change(ln_stiffness=p["near"] * near, ln_pressure=p["far"] * far + 0.0 * leak)

IRREGULARITY = Irregularity("two_fields", "fabrication",
    (Parameter("near", "1", 0.0, 1.0, "near"), Parameter("far", "1", 0.0, 1.0, "far")), "test", act)
"""


def own_population(folder: Path, code: str, table: str) -> object:
    (folder / "mine").mkdir()
    (folder / "mine" / "two_fields.py").write_text(code, encoding="utf-8")
    bare = msgspec.structs.replace(SPEC, irregularity={}).to_toml().replace("irregularity_folders = []\n", "")
    (folder / "population.toml").write_text(f'irregularity_folders = ["mine"]\n{bare}\n{table}', encoding="utf-8")
    return load_spec(folder / "population.toml")


def test_a_new_irregularity_brings_its_own_latent_normals(tmp_path: Path) -> None:
    """Two fields of one stream are correlated at a die as those of a seeded wafer."""
    spec = own_population(tmp_path, FIELDS, "[irregularity.two_fields]\nnear = 0.01\nfar = 0.01\n")
    space = latent_space(spec)
    assert [name.split("[")[0] for name in space.names] == [
        "wafer/die", "two_fields/wafer/field", "two_fields/wafer/field", "two_fields/die//uniform",
    ]  # fmt: skip
    z = np.random.default_rng(1).standard_normal((100_000, space.dimension))
    z[:, space.first["wafer/die"]] = 2.0  # near the edge
    drawn = draw_latent(spec, space, z, 1)
    near = 2.0 * np.log(drawn.true["f3_hz"] / SPEC.device.updown_hz) / 0.01
    at = int(np.flatnonzero(np.all(die_centres(SPEC.wafer) == [drawn.die_x_mm[0], drawn.die_y_mm[0]], axis=1))[0])
    rows = [field_factor(SPEC.wafer, length)[at] for length in (5.0, 40.0)]
    gas = np.log(drawn.true["zeta3"] * drawn.true["f3_hz"])
    expected = float(rows[0] @ rows[1])
    assert 0.1 < expected < 0.95
    assert np.corrcoef(near, gas)[0, 1] == pytest.approx(expected, abs=0.01)
    assert np.std(near) == pytest.approx(1.0, rel=0.02)


def test_numbers_that_only_some_devices_read_are_refused(tmp_path: Path) -> None:
    code = FIELDS.replace("leak = site", 'leak = site.normal("die")[0] if len(site.index) > 1 else site')
    spec = own_population(tmp_path, code, "[irregularity.two_fields]\nnear = 0.01\n")
    space = latent_space(spec)
    with pytest.raises(ConfigError, match="other random numbers"):
        draw_latent(spec, space, np.zeros((2, space.dimension)), 1)


def test_normals_of_another_shape_are_refused() -> None:
    with pytest.raises(UsageError, match="another shape"):
        draw_latent(SPEC, SPACE, np.zeros((3, SPACE.dimension + 1)), 1)
