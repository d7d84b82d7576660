from io import BytesIO

import pytest

from smarttac_can.bench.simulation import plate_od
from smarttac_can.device.frame import Frame
from smarttac_can.timing.loop_figure import histogram
from smarttac_can.timing.loop_timing import LoopTiming


@pytest.fixture
def timing() -> LoopTiming:
    timing = LoopTiming(plate_od())
    for second in (0.0, 1.001):
        timing.feed(second, Frame(0x80))
    for delays, late in ((timing.sync, 0), (timing.measurement, 200), (timing.drive, 450)):
        for n in range(1000):
            delays.add((late + n % 50) * 1e-6)
    timing.drive.add(4e-3)
    return timing


def test_every_delay_is_in_the_histogram(timing: LoopTiming) -> None:
    figure = histogram(timing)
    figure.savefig(BytesIO(), format="png", dpi=50)
    (axes,) = figure.axes
    assert axes.get_xlabel() == "delay (ms)"
    assert axes.get_yscale() == "log"
    assert axes.get_title(loc="left") == "Delays in 1001 ticks of the loop, 1001 missed"
    curves = {patch.get_label(): patch.get_data() for patch in axes.patches}
    assert [sum(data.values) for data in curves.values()] == [1000, 1000, 1001]
    assert "drive after SYNC, at most 4.00 ms" in curves
    drives = curves["drive after SYNC, at most 4.00 ms"]
    assert drives.edges[0] == 0
    assert 4.0 < drives.edges[-1] < 4.1
    assert drives.values[-1] == 1
    assert len({patch.get_linestyle() for patch in axes.patches}) == 3
