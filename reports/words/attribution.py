"""Where the loss comes from, in words."""

from __future__ import annotations

from ..attribution.content import FIELD, LOSS, PLACE, Attribution, ChangedLoss, OutputShares, Source, StoredShares
from ..attribution.reweighting import LEAST_LOTS_WITH_LOSS, ChangedShare
from ..interval_estimate import IntervalEstimate
from ..yields import clopper_pearson
from .numbers import number
from .rare import share_words

#: Sources that the terminal lists; the others are added up.
_SHOWN = 12
#: sd of the largest share above which the shares say nothing: its interval is then wider than half of all.
UNDETERMINED = 0.13

METHOD = (
    "Shapley shares: what irregularities do together is divided equally among them, so that the shares add up to 100 %."
)
STORED = (
    "from the stored devices alone, by polynomials of their numbers; 'rest' is what these do not explain: higher terms and the"
    " error of the measurement"
)


def source_words(source: Source) -> str:
    """The name of a source."""
    if source.level == PLACE:
        return "place of the die on the wafer"
    name = source.irregularity.replace("_", " ")
    return f"{name}, {'within the wafer' if source.level == FIELD else source.level}"


def percent_words(share: IntervalEstimate) -> str:
    """A share with its interval in percent."""
    low, high = (number(100.0 * min(max(end, 0.0), 1.0), 3) for end in (share.low, share.high))
    return f"{number(100.0 * share.value, 3)} % ({low} to {high})"


def output_words(output: str) -> str:
    """The name of an output."""
    if output == LOSS:
        return "loss to any limit"
    return f"loss to the limits of {output.split(':')[1]}" if output.startswith(f"{LOSS}:") else f"variance of {output}"


def attribution_lines(found: Attribution) -> list[str]:
    """What ``gyroscreen attribute`` prints."""
    loss = found.loss()
    spread = clopper_pearson(round(loss.mean * found.samples), found.samples)
    lines = [
        f"true loss of the population: {share_words(loss.mean)} ({share_words(spread.low)} to {share_words(spread.high)}), from"
        f" {found.samples} virtual devices, each of a lot of its own"
    ]
    lines += _share_lines(loss, "no device of the sample is lost, or all are, so that there is nothing to attribute")
    for one in found.process[1:]:
        if one.shares and one.shares[0].share.sd > UNDETERMINED:
            lines.append(f"{output_words(one.output)}: not determined; a few extreme devices carry it")
        elif one.shares:
            top = ", ".join(f"{source_words(s.source)} {percent_words(s.share)}" for s in one.shares[:3])
            of = f" ({share_words(one.mean)})" if one.output.startswith(LOSS) else ""
            lines.append(f"{output_words(one.output)}{of}: {top}")
    lines += [METHOD, verdict_words(found.verdicts), *_stored_lines(found.stored)]
    return lines


def verdict_words(explained: IntervalEstimate | None) -> str:
    """How far the shares hold for verdicts."""
    if explained is None:
        return "verdicts: too few lots, or no differing verdicts, to compare with the truth"
    return (
        f"verdicts: {percent_words(explained)} of the variance of 'not passed' is that of the true loss and has these shares;"
        " the rest is the measurement"
    )


def _share_lines(found: OutputShares, nothing: str) -> list[str]:
    if not found.shares:
        return [nothing]
    width = max(len(source_words(one.source)) for one in found.shares)
    lines = [
        f"    {source_words(one.source):{width}s}  {percent_words(one.share)}{_halved_words(one.halved)}"
        for one in found.shares[:_SHOWN]
    ]
    others = sum(one.share.value for one in found.shares[_SHOWN:])
    if found.shares[_SHOWN:]:
        lines.append(f"    {f'{len(found.shares) - _SHOWN} others':{width}s}  {number(100.0 * others, 3)} %")
    if found.rest is not None:
        lines.append(f"    {'rest':{width}s}  {percent_words(found.rest)}")
    return lines


def _halved_words(change: IntervalEstimate | None) -> str:
    """What halving a source does to the loss."""
    if change is None:
        return ""
    points = [number(100.0 * value, 2) for value in (change.value, change.low, change.high)]
    return f"; halved: {points[0]} points of loss ({points[1]} to {points[2]})"


def _stored_lines(found: StoredShares | None) -> list[str]:
    if found is None:
        return []
    if found.reason:
        return [f"stored devices: {found.reason}"]
    lines = [f"{found.devices} stored devices of {found.lots} lots: {STORED}"]
    for one in found.outputs:
        name = "not passed" if one.output == LOSS else one.output
        if not one.shares:
            lines.append(f"{name}: does not vary enough")
            continue
        sure = [s for s in one.shares if s.share.low > 0.0][:3]
        top = ", ".join(f"{source_words(s.source)} {percent_words(s.share)}" for s in sure)
        rest = "" if one.rest is None else f"; rest {percent_words(one.rest)}"
        lines.append(f"{name}: {top or 'no share differs from zero'}{rest}")
    return lines


def what_if_lines(found: ChangedLoss) -> list[str]:
    """What ``gyroscreen attribute --what-if`` prints."""
    changes = ", ".join(f"{name} = {number(new)} (now {number(old)})" for name, (old, new) in found.changes.items())
    lines = [
        f"what if {changes}; {found.devices} stored devices of {found.lots} lots",
        f"true loss, the same devices drawn again: {_changed_words(found.truth)}",
    ]
    if found.reweighted is None:
        return [*lines, f"not reweighted: {found.refusal}"]
    names = {"truth": "true loss, devices reweighted", "verdict": "not passed, devices reweighted"}
    return [*lines, *(f"{names[name]}: {_changed_words(one)}" for name, one in found.reweighted.items())]


def _changed_words(found: ChangedShare) -> str:
    change = found.difference
    points = [number(100.0 * value, 3) for value in (change.value, change.low, change.high)]
    return (
        f"{percent_words(found.before)} -> {percent_words(found.after)};"
        f" change {points[0]} points ({points[1]} to {points[2]})"
    )


def refused(reason: str, value: str) -> str:
    """Why stored devices cannot be reweighted, and what to do."""
    return {
        "no_spread": f"{value} is no spread of random numbers, or is zero: no device of the run is an example of the change",
        "wider": f"{value}: only spreads that become smaller, but not zero; wider ones need devices that were not drawn",
        "few_lots": f"effectively {value} lots with loss, {LEAST_LOTS_WITH_LOSS:g} are needed for an interval that holds;"
        " run more devices",
    }[reason]
