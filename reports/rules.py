"""Decision rules by name: what a verdict needs besides the limits.

    [rule]                                         rule = "simple"
    name = "guard_band"                            rule = { kind = "guard_band", k = 2 }
    k = 2.0                                        rule = { kind = "guard_band", consumer_risk = 0.025 }

With y the estimate (median of the posterior) of a limited quantity, u its standard uncertainty (sd of the posterior), and d the
distance of y from an end of its limit, positive inside:

    probability   pass  P(conform to all limits) >= pass_at,  fail  <= fail_at,  undecided between
    simple        pass  all d >= 0,                           fail  otherwise                      (simple acceptance, w = 0)
    guard_band    pass  all d >= k u,                         fail  a d <= -k u,  undecided between (guard band w = k u)
       with consumer_risk = r instead of k:
                  pass  P(beyond | y, u) <= r of every quantity,  fail  P(within | y, u) <= r of one,  undecided between

The last is the guard band w = u z(1 - r) for one limit; with two limits that are few u apart both tails count, for a normal
distribution.  "Undecided" is the uncertainty range of ISO 14253-1, in which neither conformity nor nonconformity is proven.  A
rule with two outcomes (JCGM 106) rejects it: count it as not passed.

``reports.acceptance`` applies them.

Sources: JCGM 106:2012, 7 (probability of conformity), 8.2 (simple acceptance), 8.3 (guard bands); ISO 14253-1:2017, 5 and 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta, Struct
from scipy.special import ndtr, ndtri

from pipeline.errors import ConfigError
from pipeline.toml_keys import Meaning

RuleName = Literal["probability", "simple", "guard_band"]
_PASS_AT, _FAIL_AT = 0.95, 0.05
#: More than ten standard uncertainties would be no guard band but another limit.
_GuardFactor = Annotated[float, Meta(ge=0.0, le=10.0)]
_ConsumerRisk = Annotated[float, Meta(gt=0.0, lt=0.5)]


class RuleTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """``[rule]`` as it is written; ``kind`` is another word for ``name``."""

    name: Annotated[RuleName | None, Meaning("probability, simple or guard_band; absent: probability")] = None
    kind: Annotated[RuleName | None, Meaning("another word for name")] = None
    pass_at: Annotated[
        Annotated[float, Meta(gt=0.0, le=1.0)] | None,
        Meaning("probability of conformity from which on a device passes; absent: 0.95", "1"),
    ] = None
    fail_at: Annotated[
        Annotated[float, Meta(ge=0.0, lt=1.0)] | None,
        Meaning("probability of conformity up to which a device fails; absent: 0.05", "1"),
    ] = None
    k: Annotated[_GuardFactor | None, Meaning("guard band in standard uncertainties", "1")] = None
    consumer_risk: Annotated[
        _ConsumerRisk | None, Meaning("probability of nonconformity that a pass may have, in place of k", "1")
    ] = None


@dataclass(frozen=True)
class Rule:
    """A decision rule: ``pass_at`` and ``fail_at`` belong to "probability", ``k`` or ``consumer_risk`` to "guard_band"."""

    name: RuleName = "probability"
    pass_at: float = _PASS_AT
    fail_at: float = _FAIL_AT
    k: float | None = None
    consumer_risk: float | None = None

    @property
    def by_estimate(self) -> bool:
        """Whether the verdict follows from estimates and standard uncertainties, not from P(conform)."""
        return self.name != "probability"

    @property
    def equivalent(self) -> tuple[float, float]:
        """P(conform) from which on the rule passes, and up to which it fails; exact for one limit and a normal posterior."""
        if self.name == "probability":
            return self.pass_at, self.fail_at
        if self.consumer_risk is not None:
            return 1.0 - self.consumer_risk, self.consumer_risk
        k = 0.0 if self.k is None else self.k
        return float(ndtr(k)), float(ndtr(-k))

    @property
    def guard_factor(self) -> float | None:
        """k of the guard band w = k u of a single limit; 0 for simple acceptance, ``None`` for the rule "probability"."""
        if not self.by_estimate:
            return None
        if self.consumer_risk is not None:
            return float(ndtri(1.0 - self.consumer_risk))
        return 0.0 if self.k is None else self.k


def rule_of(table: RuleTable | RuleName, where: str) -> Rule:
    """The rule that a file states; ``where`` names the file in messages.

    Raises
    ------
    ConfigError : keys of another rule, two names, no guard band or two, or thresholds that are crossed.
    """
    if isinstance(table, str):
        table = RuleTable(name=table)
    if table.name is not None and table.kind is not None and table.name != table.kind:
        raise ConfigError(
            f"{where}: [rule] has two names",
            value={"name": table.name, "kind": table.kind},
            allowed="name or kind",
            next_step="remove one of them",
        )
    name = table.name or table.kind or "probability"
    given = {key for key in ("pass_at", "fail_at", "k", "consumer_risk") if getattr(table, key) is not None}
    allowed = {"probability": {"pass_at", "fail_at"}, "simple": set(), "guard_band": {"k", "consumer_risk"}}[name]
    if given - allowed:
        raise ConfigError(
            f"{where}: [rule] {name!r} does not have these keys",
            value=sorted(given - allowed),
            allowed=", ".join(sorted(allowed)) or "no further key",
            next_step='remove them, or choose another rule: "probability", "simple", "guard_band"',
        )
    if name == "guard_band" and len(given) != 1:
        raise ConfigError(
            f"{where}: [rule] 'guard_band' needs its width",
            value=sorted(given) or None,
            allowed="k (the guard band is k standard uncertainties) or consumer_risk, one of them",
            next_step='for example rule = { kind = "guard_band", k = 2 }',
        )
    pass_at = _PASS_AT if table.pass_at is None else table.pass_at
    fail_at = _FAIL_AT if table.fail_at is None else table.fail_at
    if not fail_at < pass_at:
        raise ConfigError(
            f"{where}: the thresholds of [rule] are crossed",
            value={"pass_at": pass_at, "fail_at": fail_at},
            allowed="0 <= fail_at < pass_at <= 1",
            next_step="for example pass_at = 0.95, fail_at = 0.05",
        )
    return Rule(
        name,
        pass_at,
        fail_at,
        table.k,
        table.consumer_risk,
    )
