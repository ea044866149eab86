"""Start and end real autopilots together with the world that is their physics."""

import contextlib
import math
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from sitl.emulator import Emulator
from sitl.firmware.exchange import Exchange
from sitl.firmware.process import Processes, Start
from sitl.firmware.selection import Firmware


@contextlib.contextmanager
def flying(
    emulator: Emulator, firmware: Mapping[int, Firmware], target: str, folder: Path | None
) -> Iterator[Exchange | None]:
    """Run the autopilots of the vehicles in ``firmware`` until the context ends.

    They send to the UDP address ``target``. ``folder`` keeps their parameters and logs; without it
    they are deleted. Yields None without any firmware. Raises `OSError` for sockets and files.
    """
    if not firmware or emulator.outside is None:
        yield None
        return
    with contextlib.ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="firmware")))
        starts = [
            Start(
                binary=firmware[vehicle.system].program,
                folder=folder / f"vehicle{vehicle.system}",
                instance=instance,
                system=vehicle.system,
                heading=math.degrees(vehicle.spec.heading) % 360.0,
                gripper=vehicle.gripper.installed,
                parameters=vehicle.spec.parameters,
                target=target,
            )
            for instance, vehicle in enumerate(
                one for one in emulator.vehicles if one.system in firmware
            )
        ]
        exchange = Exchange(emulator, emulator.outside, [start.instance for start in starts])
        stack.callback(exchange.close)
        stack.callback(Processes(starts, emulator.world.origin).stop)
        yield exchange
