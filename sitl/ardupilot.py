from sitl.px4 import Px4 as ArduPilot
from sitl.px4 import STREAMS

DATA_STREAMS: dict[int, tuple[str, ...]] = {}
