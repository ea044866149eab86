"""All vehicles, the cable and their links in virtual time: no sockets, no clock.

`Emulator.receive` delivers bytes to a vehicle, `Emulator.step` advances physics and autopilots to a
time and returns the bytes that they sent, `Emulator.truth` returns ground truth. The same world,
seed and bytes at the same times give the same result. Ground truth is never sent over MAVLink.
"""

import functools
import itertools
import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.autopilots import services, telemetry
from sitl.autopilots.ardupilot import ArduPilot
from sitl.autopilots.px4 import Px4
from sitl.cable.grips import FreeMotion
from sitl.cable.swinging import AnyRope, SwingingRope, make_rope
from sitl.faults import Fault, Injector
from sitl.physics import motion, rigid_bodies
from sitl.physics.contacts import Contacts
from sitl.physics.dynamics import STEP, Array, Bodies, Flags, downwash_at
from sitl.physics.geodesy import Geodesy
from sitl.protocol import wire
from sitl.protocol.incoming import Incoming, Received
from sitl.protocol.vehicle import Environment, Vehicle
from sitl.protocol.wire import Link
from sitl.world import World

_link_of = operator.itemgetter(0)
_EPOCH = 1_800_000_000.0
"""Unix time at the emulator's time zero, seconds."""
AUTOPILOT_STEPS, _AIR_STEPS, _BATTERY_STEPS, _WASH_STEPS = 2, 5, 25, 50
"""Steps of physics between updates of autopilots, air, batteries, downwash on the cable."""
_WASH_STRIDE = 3
"""Downwash is computed for every third sample of the cable."""
_VISION_TIMEOUT = 1.0


@dataclass(frozen=True)
class Truth:
    """Ground truth at ``time`` (world ENU, SI), for tests and records only.

    ``position`` (n, 3) are grip points in the file's order of vehicles, ``velocity`` (n, 3),
    ``tilt`` (n,) radians from vertical, ``gripped`` (n,), ``grip_arc`` (n,) the arc length of each
    grip (NaN: none), ``cable`` (m, 3) samples along the cable (empty without one), ``tension``,
    ``chord`` and ``length`` of the spans between grips, ``contacts`` between vehicles or with the
    ground, ``strikes`` of rotors on cable and all ``events`` since the start.
    """

    time: float
    ids: tuple[int, ...]
    position: Array
    velocity: Array
    tilt: Array
    armed: NDArray[np.bool_]
    landed: NDArray[np.bool_]
    gripped: NDArray[np.bool_]
    grip_arc: Array
    cable: Array
    tension: Array
    chord: Array
    length: Array
    charge: Array
    contacts: tuple[dict[str, Any], ...]
    strikes: tuple[dict[str, Any], ...]
    events: tuple[dict[str, Any], ...]


class Emulator:
    """The emulated team.

    ``kinds`` are the links that every vehicle has from the start ("onboard" or "gcs"). ``outside``
    are the system ids of vehicles that real autopilots control: they have no links here. Raises
    `WorldError` for parameters that an emulated autopilot does not have.
    """

    def __init__(
        self,
        world: World,
        faults: Sequence[Fault] = (),
        kinds: Sequence[str] = ("onboard",),
        outside: Sequence[int] = (),
    ) -> None:
        self.world = world
        seeds = np.random.SeedSequence(world.seed).spawn(len(world.vehicles) + 2)
        self.bodies = Bodies(world, np.random.default_rng(seeds[0]))
        self.time = 0.0
        self._steps = 0
        self._key: bytes | None = None
        self._landed_changes = 0
        self.events: list[dict[str, Any]] = []
        self.rope: AnyRope | None = (
            make_rope(world.cable, world.floor, np.array(world.wind.steady))
            if world.cable
            else None
        )
        self.contacts = Contacts(self.bodies)
        rows = [i for i, spec in enumerate(world.vehicles) if spec.id in outside]
        self.outside = rigid_bodies.RigidBodies(self.bodies, rows) if rows else None
        self._pull = np.zeros((self.bodies.count, 3))
        origin = world.origin
        self.environment = Environment(
            bodies=self.bodies,
            geodesy=Geodesy.at(origin.latitude, origin.longitude, origin.altitude),
            grab=self._grab,
            release=self._release,
            event=self._event,
            unix_time=_EPOCH,
            indoor=world.indoor,
        )
        self.vehicles = [
            Vehicle(i, spec, world, self.environment, np.random.default_rng(seeds[i + 1]))
            for i, spec in enumerate(world.vehicles)
        ]
        self._ids = [vehicle.system for vehicle in self.vehicles]
        self._incoming = Incoming(self.bodies, self._ids, services.handle)
        self.by_id = {vehicle.system: vehicle for vehicle in self.vehicles}
        for vehicle in self.vehicles:
            vehicle.frozen = vehicle.system in outside
            make = Px4 if vehicle.spec.autopilot == "px4" else ArduPilot
            vehicle.autopilot = make(vehicle)
            for kind in () if vehicle.frozen else kinds:
                self.open_link(vehicle, kind)
            if vehicle.global_valid:
                vehicle.set_home_here()
        self._links = [(v, link) for v in self.vehicles for link in v.links]
        self._attach_tied()
        self.injector = Injector(
            self.vehicles, self.bodies, self.rope, faults, np.random.default_rng(seeds[-1])
        )
        for vehicle in self.vehicles:
            vehicle.inject = functools.partial(self.injector.inject, vehicle)
            vehicle.on_sim_parameter = functools.partial(self.injector.apply_parameter, vehicle)
        services.start_with_given(self.vehicles)

    def sign_with(self, key: bytes, unix_time: float) -> None:
        """Sign all frames with a key, and drop frames that are not signed with it.

        ``unix_time`` is the vehicles' Unix time at the emulator's time zero.
        """
        self._key = key
        for vehicle in self.vehicles:
            vehicle.environment.unix_time = unix_time
            for number, link in enumerate(vehicle.links):
                self._set_key(link, number)

    def _set_key(self, link: Link, number: int) -> None:
        if self._key is not None:
            link.receiver.set_key(self._key)
            link.sender.signer = wire.Signer(self._key, number, 0)

    def open_link(self, vehicle: Vehicle, kind: str) -> Link:
        """Open a connection of a kind ("onboard" or "gcs") with the autopilot's default streams."""
        link = vehicle.add_link(kind)
        vehicle.origin_announced_at = vehicle.now
        self._set_key(link, len(vehicle.links) - 1)
        rates = telemetry.default_streams(vehicle, link)
        spread = np.linspace(0.0, 1.0, len(rates) * 7)[1:]
        for k, (name, rate) in enumerate(rates.items()):
            phase = float(spread[(k * 3 + vehicle.index) % len(spread)]) / rate
            link.stream(name, 1.0 / rate, vehicle.now + phase)
        self._links = [(v, each) for v in self.vehicles for each in v.links]
        return link

    def close_link(self, vehicle: Vehicle, link: Link) -> None:
        """Close a connection."""
        vehicle.links.remove(link)
        vehicle.parameter_queue = [
            entry for entry in vehicle.parameter_queue if entry[0] is not link
        ]
        self._links = [(v, each) for v in self.vehicles for each in v.links]

    def _attach_tied(self) -> None:
        if self.rope is None or self.world.cable is None:
            return
        tied = [v for v in self.vehicles if v.spec.gripper == "attached"]
        grips = self.bodies.grip_points()
        for vehicle, arc in zip(tied, self.world.cable.attached or (), strict=True):
            self.rope.attach(vehicle.index, min(arc, self.rope.length), grips[vehicle.index])
            vehicle.gripper.gripped = True

    def receive(self, sysid: int, data: bytes, now: float) -> None:
        """Deliver bytes from a ground station to one vehicle at emulated time ``now``."""
        vehicle = self.by_id.get(sysid)
        if vehicle is not None:
            self.deliver(vehicle, vehicle.links[0], data, now)

    def receive_all(self, sent: Iterable[tuple[int, bytes]], now: float) -> None:
        """Deliver (system id, bytes) to any number of vehicles; faster than `receive`."""
        known = [(self.by_id[sysid], data) for sysid, data in sent if sysid in self.by_id]
        self._deliver([(vehicle, vehicle.links[0], data) for vehicle, data in known], now)

    def step(self, now: float) -> list[tuple[int, bytes]]:
        """Advance to ``now`` seconds; return the (system id, bytes) that were sent meanwhile."""
        self.advance(now)
        return [(vehicle.system, data) for vehicle, _, data in self.collect()]

    def deliver(self, vehicle: Vehicle, link: Link, data: bytes, now: float) -> None:
        """Deliver bytes to one of a vehicle's links, as `receive`."""
        self._deliver([(vehicle, link, data)], now)

    def _deliver(self, sent: list[Received], now: float) -> None:
        """Deliver bytes to vehicles; those on links with faults wait in their channels."""
        if self.injector.link_faults:
            direct, up = [], self.injector.up
            for packet in sent:
                channel = up[packet[0].index]
                if channel.fault is None and not channel.queue:
                    direct.append(packet)
                else:
                    channel.push_all((packet,), now)
            sent = direct
        self._incoming.deliver(sent, now)

    def _deliver_delayed(self, now: float) -> None:
        """Deliver the bytes that arrive now through links with faults."""
        if not self.injector.link_faults:
            return
        limit = now + 1e-9
        arrived: list[Received] = []
        for channel in self.injector.up:
            queue = channel.queue
            if queue and queue[0][0] <= limit:
                arrived += channel.pop(now)
        if arrived:
            self._incoming.deliver(arrived, now)

    def advance(self, now: float) -> None:
        """Advance physics and autopilots to ``now`` seconds; their frames wait in the links."""
        while (self._steps + 1) * STEP <= now + 1e-9:
            self._steps += 1
            self.time = self._steps * STEP
            self._step()

    def collect(self) -> list[tuple[Vehicle, Link, bytes]]:
        """Return the bytes that wait in the links, and remove them."""
        sent = []
        down = self.injector.down
        for vehicle, link in self._links:
            if link.outgoing:
                channel = down[vehicle.index]
                if vehicle.frozen:
                    pass
                elif channel.fault is not None or channel.queue:
                    channel.push_all([(link, frame) for frame in link.outgoing], self.time)
                else:
                    sent.append((vehicle, link, b"".join(link.outgoing)))
                link.outgoing.clear()
        if not self.injector.link_faults:
            return sent
        limit = self.time + 1e-9
        for vehicle, channel in zip(self.vehicles, down, strict=True):
            if channel.queue and channel.queue[0][0] <= limit:
                arrived = channel.pop(self.time)
                if len(arrived) == 1:
                    sent.append((vehicle, *arrived[0]))
                    continue
                for link, frames in itertools.groupby(arrived, key=_link_of):
                    sent.append((vehicle, link, b"".join([frame for _, frame in frames])))
        return sent

    def inject(self, fault: Fault) -> None:
        """Schedule a fault; a fault in the past starts at the next step."""
        self.injector.add(fault)

    def grips_and_cable(self) -> tuple[Array, Array, Array]:
        """Return grip points (n, 3), their arc lengths (n,; NaN: free) and cable samples (m, 3).

        This is the part of ground truth that dry runs need often.
        """
        rope = self.rope
        arcs = np.full(self.bodies.count, math.nan)
        for arc, holder in rope.grips if rope else ():
            if holder < len(arcs):
                arcs[holder] = arc
        grips = self.bodies.grip_points()
        cable = rope.update(self._holders()[0], 0.0).copy() if rope else np.zeros((0, 3))
        return grips, arcs, cable

    def truth(self) -> Truth:
        """Return ground truth, for tests and records only."""
        b = self.bodies
        rope = self.rope
        grips, arcs, cable = self.grips_and_cable()
        spans = rope.solved if rope else None
        empty = np.zeros(0)
        return Truth(
            time=self.time,
            ids=tuple(v.system for v in self.vehicles),
            position=grips,
            velocity=b.velocity.copy(),
            tilt=motion.tilts(b.state, b.tumbling, b.tumble),
            armed=b.armed.copy(),
            landed=b.landed.copy(),
            gripped=np.array([v.gripper.gripped for v in self.vehicles]),
            grip_arc=arcs,
            cable=cable,
            tension=spans.tension.copy() if spans else empty,
            chord=spans.chord.copy() if spans else empty,
            length=spans.length.copy() if spans else empty,
            charge=np.array([v.charge for v in self.vehicles]),
            contacts=tuple(self.contacts.contacts),
            strikes=tuple(self.contacts.strikes),
            events=tuple(self.events),
        )

    def _step(self) -> None:
        now = self.time
        b = self.bodies
        if self.injector.tick(now):
            self._wake()
        self._deliver_delayed(now)
        rope = self.rope
        if self.outside is not None:
            b.set_external_force(self._pull / rigid_bodies.SUBSTEPS)
            self._pull[:] = 0.0
        elif rope is not None and self._steps % rope.force_interval == 0:
            force = rope.forces(*self._holders(), self._free_motion())
            b.set_external_force(force[: b.count])
            if self.injector.anchors:
                self.injector.drag(force[b.count :], rope.force_interval * STEP)
        hit = b.step()
        if self.outside is not None:
            self.outside.place(b)
        if hit is not None:
            self._record_crashes(hit)
        if self._steps % _AIR_STEPS == 0:
            self._update_air(_AIR_STEPS * STEP)
        if self._steps % AUTOPILOT_STEPS == 0:
            b.supervise(AUTOPILOT_STEPS * STEP)
            if b.landed_changes != self._landed_changes:
                self._landed_changes = b.landed_changes
                self._wake()
            for vehicle in self.vehicles:
                if vehicle.next_check_at <= now:
                    services.update(vehicle, now)
        telemetry.send_due(self._links, now)

    def advance_outside(self, command: Array, ahead: float) -> None:
        """Advance the vehicles of real autopilots, and the cable, by one of their substeps.

        ``command`` (k, 4) are motor commands between 0 and 1; the substep begins ``ahead`` seconds
        after the present time of the world, which follows with `advance`. The emulated vehicles
        keep their velocity until then.
        """
        outside, interval = self.outside, STEP / rigid_bodies.SUBSTEPS
        if outside is None:
            raise ValueError("no vehicle is controlled from outside")
        force = np.zeros((self.bodies.count, 3))
        if isinstance(self.rope, SwingingRope):
            grips, velocity = self._holders()
            grips = grips + (ahead + interval) * velocity
            grips[outside.rows] = outside.grip_points()
            force = self.rope.forces(grips, velocity, None, interval)[: self.bodies.count]
        self._pull += force
        now = self.time + ahead + interval
        held = {i: hands.pose(now) for i, hands in self.injector.hands.items()}
        outside.advance(command, force[outside.rows], self.bodies, held)

    def _record_crashes(self, hit: Flags) -> None:
        for i in np.nonzero(hit)[0]:
            system = self.vehicles[i].system
            self.contacts.contacts.append(
                {"time": self.time, "kind": "crash", "vehicles": [system]}
            )
            self._event("crashed", system)

    def _holders(self) -> tuple[Array, Array]:
        """Return positions and velocities (n, 3) of all holders of cable: vehicles, then snags."""
        anchors = [anchor.position for anchor in self.injector.anchors]
        grips, velocity = self.bodies.grip_points(), self.bodies.velocity
        if not anchors:
            return grips, velocity
        return np.vstack([grips, anchors]), np.vstack([velocity, np.zeros((len(anchors), 3))])

    def _free_motion(self) -> FreeMotion:
        """Return the motion of all holders without cable; snags resist it by friction alone."""
        snags = len(self.injector.anchors)
        acceleration, mobility = self.bodies.free_motion()
        if snags:
            acceleration = np.vstack([acceleration, np.zeros((snags, 3))])
            mobility = np.append(mobility, np.zeros(snags))
        return FreeMotion(acceleration, mobility)

    def _wake(self) -> None:
        """Make every autopilot check again after an event that may concern it."""
        for vehicle in self.vehicles:
            vehicle.next_check_at = -math.inf

    def _update_air(self, interval: float) -> None:
        b = self.bodies
        b.step_disturbances(interval)
        if self._steps % _BATTERY_STEPS == 0:
            telemetry.discharge(self.vehicles, b, _BATTERY_STEPS * STEP)
            self._detect_lost_vision()
        cable = None
        rope = self.rope
        if rope is not None:
            wash_due = self._steps % _WASH_STEPS == 0
            if wash_due or rope.within_reach(b.position, b.radius):
                cable = rope.update(self._holders()[0], interval, solved=True)
                if wash_due:
                    washed = cable[::_WASH_STRIDE]
                    rope.set_wash(downwash_at(washed, b.position, b.lift(), b.radius), _WASH_STRIDE)
        self.contacts.detect(self.time, self._ids, cable)

    def _detect_lost_vision(self) -> None:
        for vehicle in self.vehicles:
            silence = self.time - vehicle.vision_at
            if math.isfinite(silence) and silence > _VISION_TIMEOUT and not vehicle.vision_lost:
                vehicle.vision_lost, vehicle.local_valid = True, False
                vehicle.next_check_at = -math.inf

    def _event(self, kind: str, vehicle: int, **details: Any) -> None:
        self.events.append({"time": self.time, "kind": kind, "vehicle": vehicle, **details})

    def _grab(self, index: int) -> bool:
        if self.rope is None:
            return False
        grips = self.bodies.grip_points()
        self.rope.update(self._holders()[0], 0.0)
        arc = self.rope.grab(index, grips[index])
        held = arc is not None
        self._event("grabbed" if held else "grab failed", self.vehicles[index].system, arc=arc)
        return held

    def _release(self, index: int) -> bool:
        if self.rope is None:
            return False
        self.rope.update(self._holders()[0], 0.0)
        held = self.rope.release(index)
        if held:
            self._event("released", self.vehicles[index].system)
            self.injector.drop_snags()
        return held
