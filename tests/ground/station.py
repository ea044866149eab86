"""A ground station in a process of its own, so that a test can kill it: python -m MODULE ARGUMENTS.

``fly FOLDER PORT SPEED CLOCK`` begins a flight that follows a world's clock;
``resume RECORD PORT SPEED CLOCK THEN`` takes one up.
"""

import sys
import time
from pathlib import Path

from pymavlink.dialects.v20 import common

from swarm.flight.conductor import Conductor
from swarm.flight.flight_plan import ResumedFlight, go
from swarm.flight.router import Outgoing
from swarm.flight.tlog import ClockEncoder, left_off
from swarm.ground.loop import Loop
from swarm.ground.record import Record
from swarm.ground.record_reader import recorded_certificate, recorded_plan
from swarm.ground.sockets import open_links
from swarm.ground.world_clock import WorldClock
from swarm.mission.fleet import Fleet, emulated_fleet
from tests.network import small_plan

FLIGHT_PLAN = small_plan()


def fleet_on(port: int) -> Fleet:
    """Return a fleet of ArduPilot vehicles on one UDP link, not emulated."""
    fleet = emulated_fleet(3, ("ardupilot",))
    links = {"loopback": f"udpin://127.0.0.1:{port}"}
    return fleet.model_copy(update={"emulated": None, "links": links})


def as_audited(conductor: Conductor, sysid: int) -> Outgoing:
    """Return a PARAM_SET of GUID_TIMEOUT to 0.5 s, the value that the audit requires."""
    way = conductor.team.way_to(sysid)
    wanted = common.MAVLink_param_set_message(sysid, 1, b"GUID_TIMEOUT", 0.5, 9)
    return Outgoing(way.link, way.address, way.encoder.encode(wanted))


def run(conductor: Conductor, folder: Path, speed: float, world: WorldClock) -> None:
    """Fly to the end, with a record, and print the events."""
    links = open_links(conductor.fleet.links)
    record = Record(folder, time.time())
    record.before(conductor.flight_plan, conductor.basis, conductor.fleet, {})
    if conductor.state.resumption.left_off is not None:
        record.frames(conductor.state.resumption.left_off.known)
    clock = ClockEncoder(conductor.plan)

    def each_tick(now: float) -> None:
        if conductor.stage == "ready" and conductor.audit is not None:
            links.send([as_audited(conductor, listed.sysid) for listed in conductor.fleet.vehicles])
            conductor.start(go(conductor.flight_plan, conductor.audit))
        phase = conductor.phase.name if conductor.stage == "execute" else ""
        if conductor.stage in {"ready", "execute", "contingency"}:
            record.packet(clock.encode(now, conductor.clock.time, phase), now)
        for event in conductor.events():
            record.event(event)
            print(f"{event.kind}: {event.message}", flush=True)
        if phase == "fold" and conductor.clock.time > conductor.plan.phase("fold").start + 3.0:
            print("folding", flush=True)

    Loop(conductor, links, record, speed, each_tick, world=world).run()
    record.close()
    links.close()
    world.close()


if __name__ == "__main__":
    what, folder, port, speed, clock, *then = sys.argv[1:]
    world = WorldClock(Path(clock), float(speed))
    fleet = fleet_on(int(port))
    if what == "fly":
        run(Conductor(FLIGHT_PLAN, fleet), Path(folder), float(speed), world)
    else:
        resumed = ResumedFlight(recorded_plan(Path(folder)), *recorded_certificate(Path(folder)))
        tlog = (Path(folder) / "flight.tlog").read_bytes()
        left = left_off(tlog, resumed.plan, fleet)
        conductor = Conductor(resumed, fleet, left=left, then=then[0])
        run(conductor, Path(folder) / "resumed", float(speed), world)
