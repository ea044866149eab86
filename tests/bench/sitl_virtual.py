"""Speed of the emulator in virtual time: nine vehicles on one cable.

Setpoints arrive at 20 Hz and positions leave at 10 Hz, as MAVLink bytes; the ratio is to the CPU
time of one core. Run: ``python tests/bench/sitl_virtual.py [vehicles] [seconds]``.
"""

import sys
import time

from pymavlink.dialects.v20 import common as dialect

from sitl import Emulator, parse_world

RISE, SPACING, SPAN = 4.0, 3.0, 3.6


def world_text(count: int) -> str:
    vehicles = ", ".join(
        f"{{id: {i + 1}, pad: [{SPACING * i}, 0, 0], gripper: attached}}" for i in range(count)
    )
    arcs = [round(SPAN * i, 3) for i in range(count)]
    return (
        f"{{schema: 1, vehicles: [{vehicles}], "
        f"cable: {{points: [[0, 0, 0], [{arcs[-1]}, 0, 0]], attached: {arcs}}}}}"
    )


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 9
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
    emulator = Emulator(parse_world(world_text(count)))
    mav = dialect.MAVLink(None, 255, 190)
    now = 0.0
    streams = []
    for vehicle in emulator.vehicles:
        x, y, z = vehicle.origin
        goal = (-y, SPACING * vehicle.index - x, -(RISE - z))
        message = dialect.MAVLink_set_position_target_local_ned_message(
            0, vehicle.system, 1, 1, 3072, *goal, *[0.0] * 8
        )
        streams.append((vehicle.system, message.pack(mav)))
        for name in list(vehicle.links[0].intervals):
            if name != "HEARTBEAT":
                vehicle.links[0].stream(name, 0.1 if name == "LOCAL_POSITION_NED" else None, 0.0)

    def run(duration: float) -> int:
        nonlocal now
        sent = 0
        end = now + duration
        while now < end - 1e-9:
            now = round(now + 0.05, 6)
            emulator.receive_all(streams, now)
            sent += len(emulator.step(now))
        return sent

    def command(number: int, *p: float) -> None:
        values = [*p, *[0.0] * (7 - len(p))]
        for system, _ in streams:
            message = dialect.MAVLink_command_long_message(system, 1, number, 0, *values)
            emulator.receive(system, message.pack(mav), now)

    run(1.0)
    command(dialect.MAV_CMD_DO_SET_MODE, 1, 6)
    command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    run(10.0)
    truth = emulator.truth()
    assert truth.position[:, 2].min() > RISE - 1.0, "it should fly"
    best = 0.0
    for _ in range(5):
        start = time.process_time()
        run(seconds / 5)
        best = max(best, seconds / 5 / (time.process_time() - start))
    print(f"{count} vehicles, one cable: {best:.0f} × real time on one core (best of five)")


if __name__ == "__main__":
    main()
