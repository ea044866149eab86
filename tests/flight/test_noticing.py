"""What is noticed in flight, however the reports come."""

import pytest

from sitl.faults import Fault
from tests.network import Network, small_plan

PLAN = small_plan()


@pytest.mark.parametrize("early", [0.0, 0.013], ids=["in step", "between ticks"])
def test_a_position_that_jumps_is_noticed_whenever_its_report_comes(early):
    flight = Network(PLAN, early=early)
    flight.until_phase("fold", 1.0)
    flight.emulator.inject(Fault(at=0.0, kind="gps_jump", vehicle=2, offset=(2.0, 0.0, 0.0)))
    flight.run(lambda: flight.conductor.stage == "leave", most=5.0)
    assert any("vehicle 2's position jumped by 2.0 m" in words for words in flight.words())
