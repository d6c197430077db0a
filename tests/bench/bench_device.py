"""A whole device of the default run, from its draw to its rows: a block of eight, as a worker treats it."""

from bench.device import TOGETHER, device

from workflows.screening.block import DeviceBlock, virtual_block

PART = "device"


def test_part_device(timed):
    d, block = device(), DeviceBlock(0, 0, TOGETHER)
    found = timed.part(
        PART, lambda: virtual_block(d.config, block), {}, "the sum of its parts", inside="", devices=TOGETHER
    )
    assert found.statuses == {"ok": TOGETHER}
