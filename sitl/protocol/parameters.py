"""Parameters of an autopilot: typed values by name, in a fixed order, and their encoding.

PX4 sends the four bytes of an integer in the float field, ArduPilot the number as a float.
"""

import math
import struct
from dataclasses import dataclass, field

INT32, REAL32 = 6, 9
INT8, INT16 = 2, 4
_RANGES = {INT8: (-128, 127), INT16: (-32768, 32767), INT32: (-(2**31), 2**31 - 1)}


@dataclass
class Parameters:
    """An ordered table of parameters; an ``int`` value makes an integer parameter."""

    values: dict[str, float | int] = field(default_factory=dict)
    kinds: dict[str, int] = field(default_factory=dict)
    bytewise: bool = True

    def load(self, table: dict[str, float | int], kinds: dict[str, int] | None = None) -> None:
        """Load a table of defaults; ``kinds`` are other MAV_PARAM_TYPEs than INT32 and REAL32."""
        for name in sorted(table):
            self.values[name] = table[name]
            kind = INT32 if isinstance(table[name], int) else REAL32
            self.kinds[name] = (kinds or {}).get(name, kind)
        self.names = list(self.values)
        self.indices = {name: i for i, name in enumerate(self.names)}

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def integer(self, name: str) -> int:
        """Return an integer parameter."""
        return int(self.values[name])

    def encode(self, name: str) -> bytes:
        """Return the four bytes of the value in PARAM_VALUE."""
        value = self.values[name]
        if self.kinds[name] == REAL32 or not self.bytewise:
            return struct.pack("<f", value)
        return struct.pack("<i", int(value))

    def decode(self, name: str, raw: bytes, kind: int) -> float | int | None:
        """Return the value of four received bytes for this parameter, None if unusable."""
        if self.kinds[name] == REAL32:
            value = float(struct.unpack("<f", raw)[0])
            return value if math.isfinite(value) else None
        if self.bytewise and kind != REAL32:
            whole = struct.unpack("<i", raw)[0]
        else:
            number = struct.unpack("<f", raw)[0]
            if not math.isfinite(number):
                return None
            whole = round(number)
        low, high = _RANGES[self.kinds[name]]
        return whole if low <= whole <= high else None
