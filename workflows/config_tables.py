"""The tables of a run configuration, each with its defaults: those of the paper's experiment.

Units are the ends of the keys' names.  Tables of the instrument and of the demodulation extend those that campaigns use;
the ranges are the same, and a key that is left out has the paper's value.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from pipeline.device.operation.trim import Target
from pipeline.device.operation.trim_electrodes import Electrodes, standard_electrodes
from pipeline.experiment.files.common_tables import (
    NotNegative,
    Positive,
    Value,
)
from pipeline.inference.gate import Gate
from pipeline.inference.screening.sample import SamplerSettings
from pipeline.toml_files import MAY_BE_INFINITE
from pipeline.toml_keys import Meaning
from reports.limits import BoundsTable, Limits

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
#: Mean and sd of a parameter of an effect; the largest range of one ends at 1e15.
EffectSize = Annotated[float, Meta(ge=-1e30, le=1e30)]
EffectSpread = Annotated[float, Meta(ge=0.0, le=1e30)]
#: An upper limit of something; inf switches it off.
Threshold = Annotated[float, Meta(gt=0.0, extra=MAY_BE_INFINITE)]
#: Quantities whose bias by an undetected effect the gate judges, where they have limits.
GATED = (
    "theta_deg", "split_hz", "zeta1", "zeta2", "zeta3", "quality1", "quality2", "quality3", "c12_per_s", "rate_bias_dps"
)  # fmt: skip


class RunTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Number of devices, seed, devices per block, and workers (0: one per core).

    ``device_limit_s`` is the time limit of a device [s]; absent: 20 times the median, at least 60 s.
    """

    devices: Annotated[int, Meta(ge=1, le=10_000_000), Meaning("number of virtual devices", "1")] = 200
    seed: Annotated[int, Meta(ge=0), Meaning("seed of all random streams", "1")] = 1
    block: Annotated[
        int, Meta(ge=1, le=10_000), Meaning("devices that a worker processes before they are stored", "1")
    ] = 25
    workers: Annotated[int, Meta(ge=0, le=1024), Meaning("local worker processes; 0: one per core", "1")] = 0
    device_limit_s: Annotated[
        Positive | None, Meaning("time limit of a device; absent: 20 times the median, at least 60 s")
    ] = None


class SourceTable(Struct, frozen=True, forbid_unknown_fields=True):
    """A population (``spec``: a shipped name or a TOML file; ``values``: its named assumptions), or measured campaigns.

    ``path`` is the folder that contains the campaign folders.  Paths are relative to the configuration file.  ``spec_toml`` is
    the text of the population, which a run writes into its run.toml; it takes precedence over ``spec``.
    ``store_irregularities``: keep the random numbers of each virtual device in the table ``irregularities``.
    """

    kind: Annotated[
        Literal["population", "campaigns"], Meaning("virtual devices of a population, or measured campaigns")
    ] = "population"
    spec: Annotated[str, Meaning("population: a shipped name, or a TOML file relative to this one")] = "cloverleaf"
    spec_toml: Annotated[
        str | None,
        Meaning("text of the population, which a run writes into its run.toml; it takes precedence over spec"),
    ] = None
    values: Annotated[
        dict[str, float],
        Meaning(
            'named assumptions of the population, or "irregularity.parameter", with other values',
            "that of the assumption",
        ),
    ] = {}
    path: Annotated[str | None, Meaning("folder that contains the campaign folders; for measured campaigns")] = None
    store_irregularities: Annotated[bool, Meaning("whether the random numbers of each virtual device are stored")] = (
        True
    )


class IdentificationTable(Struct, frozen=True, forbid_unknown_fields=True):
    """ARX order and window [s] of the paper's route, and the band [Hz] of the likelihood."""

    order: Annotated[int, Meta(ge=10, le=80), Meaning("order of the ARX model of the paper's route", "1")] = 40
    window_s: Annotated[Positive, Meaning("window of the paper's route")] = 2.0
    low_hz: Annotated[Positive, Meaning("lower end of the band of the likelihood")] = 400.0
    high_hz: Annotated[Positive, Meaning("upper end of the band of the likelihood")] = 700.0


class PosteriorTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Size of the emcee ensembles, criteria of convergence, and the number of stored draws per device."""

    ensembles: Annotated[int, Meta(ge=4, le=64), Meaning("independent ensembles of the sampler", "1")] = 4
    walkers: Annotated[int, Meta(ge=24, le=4096), Meaning("walkers of an ensemble", "1")] = 96
    steps: Annotated[int, Meta(ge=4, le=100_000), Meaning("steps of each walker", "1")] = 8
    rhat_max: Annotated[
        float, Meta(gt=1.0, extra=MAY_BE_INFINITE), Meaning("largest R-hat of a converged posterior", "1")
    ] = 1.01
    ess_min: Annotated[NotNegative, Meaning("least effective sample size of a converged posterior", "1")] = 1000.0
    stored_draws: Annotated[int, Meta(ge=0), Meaning("posterior draws that are stored per device; 0: none", "1")] = 100

    def settings(self) -> SamplerSettings:
        """Settings of the sampler."""
        return SamplerSettings(self.ensembles, self.walkers, self.steps, rhat_max=self.rhat_max, ess_min=self.ess_min)


class GateTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The gate: largest error [sigma], largest bound on the bias of theta [deg], and what undetected effects may do.

    ``bias_fraction`` is the largest bias that an undetected effect may cause, as a share of the width of the limits of a
    quantity: a bias of 5 % of the width changes the verdict of 5 % of devices that are spread over it.  ``effect_alpha`` is
    the probability that an effect is found in a device that has none.
    """

    error_max: Annotated[Threshold, Meaning("largest error of a device with status ok", "1")] = 1.1
    theta_bias_max_deg: Annotated[Threshold, Meaning("largest bound of the bias of theta that the residual allows")] = (
        0.5
    )
    bias_fraction: Annotated[
        Threshold,
        Meaning("largest bias that an undetected effect may cause, as a share of the width of the limits", "1"),
    ] = 0.05
    effect_alpha: Annotated[
        float,
        Meta(ge=0.0, lt=1.0),
        Meaning("probability that an effect is found in a device that has none; 0: no search", "1"),
    ] = 1e-3

    def gate(self, limits: Limits) -> Gate:
        """The gate that the table describes, for devices that are judged by ``limits``."""
        widths = {limit.quantity: limit.width for limit in limits.limits if limit.quantity in GATED}
        bias_max = {quantity: self.bias_fraction * width for quantity, width in widths.items()}
        return Gate(self.error_max, self.theta_bias_max_deg, bias_max, self.effect_alpha)


class TrimTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Electrostatic trim after the test: pairs of trim electrodes and the target; without the table there is no trim.

    ``softening_hz_per_v2`` is the shift [Hz/V^2] of the mode along the azimuth of a pair, ``gain_sd`` its relative sd.
    """

    azimuth_deg: Annotated[tuple[float, ...], Meaning("azimuth of each pair of trim electrodes, from the x axis")] = (
        0.0,
        45.0,
        90.0,
        135.0,
    )
    softening_hz_per_v2: Annotated[
        float, Meta(lt=0.0), Meaning("shift of the mode along the azimuth of a pair")
    ] = -0.03
    gain_sd: Annotated[float, Meta(ge=0.0, lt=1.0), Meaning("relative sd of that shift", "1")] = 0.05
    most_v: Annotated[Threshold, Meaning("largest trim voltage")] = 15.0
    split_hz: Annotated[NotNegative | None, Meaning("split that the trim aims at; absent: any")] = 0.0
    theta_deg: Annotated[Value | None, Meaning("theta that the trim aims at; absent: any")] = None

    def electrodes(self) -> Electrodes:
        """The electrodes that the table describes."""
        return standard_electrodes(self.azimuth_deg, self.softening_hz_per_v2, gain_sd=self.gain_sd, most_v=self.most_v)

    def target(self) -> Target:
        """The split and theta that the trim aims at."""
        return Target(self.split_hz, self.theta_deg)


class EffectTable(Struct, frozen=True, forbid_unknown_fields=True):
    """An effect that virtual devices have, whether or not the screening model contains it.

    ``size``: parameter -> mean and sd of a normal distribution over the affected devices, clipped to the effect's range.
    Affected are a ``share`` of the devices, or the ids in ``devices``; if ``lots`` is given, only in those lots.
    """

    size: Annotated[
        dict[str, tuple[EffectSize, EffectSpread]],
        Meaning(
            "parameter = [mean, sd] of a normal distribution over the affected devices, clipped to the range",
            "that of the parameter",
        ),
    ]
    share: Annotated[Share, Meaning("share of the devices that is affected", "1")] = 1.0
    devices: Annotated[tuple[str, ...], Meaning("ids of the affected devices, in place of share")] = ()
    lots: Annotated[tuple[str, ...], Meaning("lots to which the effect is limited; empty: all")] = ()


class DiagnosisTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The examination of misfits after the last block.

    At most ``most`` devices with status misfit are examined, and ``sample`` devices with status ok (absent: 2 % of them, at
    least 12), so that an effect that is too weak to flag any single device can be found.  ``alpha`` is the family-wise
    probability of a false detection.
    """

    enabled: Annotated[bool, Meaning("whether misfits are examined")] = True
    most: Annotated[int, Meta(ge=1), Meaning("misfits that are examined at most", "1")] = 200
    sample: Annotated[
        Annotated[int, Meta(ge=0)] | None,
        Meaning("devices with status ok that are examined; absent: 2 % of them, at least 12", "1"),
    ] = None
    alpha: Annotated[float, Meta(gt=0.0, lt=0.5), Meaning("family-wise probability of a false detection", "1")] = 0.003


class LotOriginTable(Struct, frozen=True, forbid_unknown_fields=True):
    """The questions at the end of a night over measured campaigns: is the lot a draw from the population, and did it drift?

    ``population`` is the one that is used for screening: a shipped name or a TOML file; ``population_toml`` is its text, which a
    run writes into its run.toml.  ``false_alarm`` is the probability of a wrong "no" to each question; up to ``nights`` earlier
    nights are looked at.
    """

    enabled: Annotated[bool, Meaning("whether a night over measured campaigns asks at its end")] = True
    population: Annotated[str, Meaning("population for screening: a shipped name or a TOML file")] = "cloverleaf"
    population_toml: Annotated[
        str | None, Meaning("text of the population; run.toml of a run holds it, write it nowhere else")
    ] = None
    false_alarm: Annotated[
        float, Meta(gt=0.0, lt=0.5), Meaning('probability of a wrong "no" to each question', "1")
    ] = 0.01
    nights: Annotated[
        int, Meta(ge=0, le=100), Meaning("earlier nights that the drift is looked for in, at most", "1")
    ] = 10


class TargetsTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Gates on the whole run.  A gate that fails sets the exit code 1 and has no other effect."""

    yield_min: Annotated[Share | None, Meaning("least yield; below it the exit code is 1", "1")] = None
    strict_convergence: Annotated[bool, Meaning("whether a posterior that has not converged sets the exit code 1")] = (
        False
    )


class SamplingTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Sampling towards rare losses: ``gyroscreen rare``.

    ``limits`` are the limited quantities whose loss is estimated (absent: all), from at most ``devices`` virtual devices.  A loss
    is decided if the half-width of its 95 % interval is at most ``precision`` of it.  ``method`` "plain" draws the devices of the
    population instead, to compare.
    """

    limits: Annotated[tuple[str, ...], Meaning("limited quantities whose loss is estimated; empty: all")] = ()
    devices: Annotated[int, Meta(ge=1, le=100_000_000), Meaning("virtual devices of an estimate at most", "1")] = 20_000
    precision: Annotated[
        float,
        Meta(gt=0.0, le=1.0),
        Meaning("half-width of the 95 % interval of a loss that is decided, relative to the loss", "1"),
    ] = 0.2
    method: Annotated[
        Literal["importance", "plain"],
        Meaning("importance: sampling towards the loss; plain: devices as the population draws them"),
    ] = "importance"


class TrendTable(Struct, frozen=True, forbid_unknown_fields=True):
    """Alarms of `gyroscreen report --against`, which set the exit code 1.

    ``false_alarm`` is the probability that a night in control raises any alarm of the control charts (absent: they are drawn, and
    decide nothing); ``limits`` bound the yield of a night, "yield", and means of its quantities.
    """

    false_alarm: Annotated[
        Annotated[float, Meta(gt=0.0, lt=0.5)] | None,
        Meaning("probability that a night in control raises any alarm; absent: charts decide nothing", "1"),
    ] = None
    limits: Annotated[
        dict[str, BoundsTable],
        Meaning('limits of the yield of a night ("yield") and of means of its quantities, one table each'),
    ] = {}
