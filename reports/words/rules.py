"""Decision rules in words."""

from __future__ import annotations

from ..rules import Rule
from .numbers import number

_NOT_OK = "or when its identification is not ok"


def rule_words(rule: Rule) -> str:
    """The rule in one sentence."""
    if rule.name == "probability":
        return (
            "A device passes when the posterior probability that it conforms to all limits together is at least"
            f" {rule.pass_at:.3g}, fails when it is at most {rule.fail_at:.3g}, and is undecided in between, {_NOT_OK}."
        )
    if rule.name == "simple":
        return (
            "Simple acceptance (JCGM 106, 8.2): a device passes when all its estimates are within the limits, and fails when one"
            f" is not; it is undecided when an estimate is not known, {_NOT_OK}."
        )
    if rule.consumer_risk is not None:
        share = f"{number(100.0 * rule.consumer_risk, 3)} %"
        return (
            "Guard band from a consumer's risk (JCGM 106, 8.3; ISO 14253-1): a device passes when every quantity is beyond its"
            f" limits with a probability of at most {share}, by its estimate and standard uncertainty u"
            f" ({number(rule.guard_factor or 0.0, 3)} u inside a single limit), fails when one is within them with a probability"
            f" of at most {share}, and is undecided in between, {_NOT_OK}."
        )
    return (
        f"Guard band of {number(rule.k or 0.0, 3)} u (JCGM 106, 8.3; ISO 14253-1): a device passes when all its estimates are"
        " inside the limits by that many standard uncertainties u, fails when one is beyond a limit by as many, and is undecided"
        f" in between, {_NOT_OK}."
    )
