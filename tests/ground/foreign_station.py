"""Another ground station, that listens to the read-only copy and commands in vain."""

import threading

from pymavlink import mavutil


class ForeignStation(threading.Thread):
    """A client of pymavlink that hears vehicles, and orders each of them to disarm in the air."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.port = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=254)
        self.url = f"udp://127.0.0.1:{self.port.port.getsockname()[1]}"
        self.heard: set[tuple[int, str]] = set()
        self.ordered = 0
        self.over = threading.Event()

    def __enter__(self) -> "ForeignStation":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()
        self.join(5)
        self.port.close()

    def run(self) -> None:
        force = 21196  # the value that disarms in the air
        while not self.over.is_set():
            message = self.port.recv_match(blocking=True, timeout=0.2)
            if message is None or message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
                continue  # pymavlink does not read the header of a message that it does not know
            self.heard.add((message.get_srcSystem(), message.get_type()))
            if message.get_type() == "HEARTBEAT":
                self.port.mav.command_long_send(
                    message.get_srcSystem(), 1, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
                    0, 0, force, 0, 0, 0, 0, 0,
                )  # fmt: skip
                self.ordered += 1
