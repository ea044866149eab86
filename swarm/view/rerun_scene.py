"""Plans and flights as Rerun entities, with one batch per quantity for all vehicles.

Timelines: ``time`` is seconds since the start of the record, ``mission_time`` the mission clock.
Planned entities are below ``plan/``, flown ones below ``flight/``.

A call to Rerun costs the same for any number of points: curves are sent in batches of them, a
moment late.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
import rerun as rr

from swarm.flight.snapshot import Event, Snapshot
from swarm.planning import Plan
from swarm.planning.cable_shape import laid_grip_points
from swarm.reports import scene
from swarm.reports.formatting import clock, event_text, log_level

Floats = npt.NDArray[np.float64]

BATCH_TIME: Final = 0.4
"""Seconds of a curve in one batch."""


class CurveBuffer:
    """Points of curves that are not sent yet, each with its time and mission time."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._waiting: dict[str, list[tuple[float, float, Floats]]] = {}
        self._last_sent = -np.inf

    def add(self, entity: str, time: float, mission_time: float, values: npt.ArrayLike) -> None:
        """Add the next point of an entity's curves (n,)."""
        row = np.atleast_1d(np.asarray(values, dtype=np.float64))
        self._waiting.setdefault(entity, []).append((time, mission_time, row))

    def send_due(self, now: float) -> None:
        """Send all points if the last batch is :data:`BATCH_TIME` old."""
        if not 0.0 <= now - self._last_sent < BATCH_TIME:
            self._last_sent = now
            self.send()

    def send(self) -> None:
        """Send all points."""
        for entity, points in self._waiting.items():
            times, clock, values = zip(*points, strict=True)
            self._stream.send_columns(
                entity,
                indexes=[
                    rr.TimeColumn("time", duration=times),
                    rr.TimeColumn("mission_time", duration=clock),
                ],
                columns=rr.Scalars.columns(scalars=np.concatenate(values)).partition(
                    [len(row) for row in values]
                ),
            )
        self._waiting.clear()


PATH_COLOUR: Final = (120, 110, 185)
GHOST_COLOUR: Final = (235, 235, 245)
PLAN_COLOUR: Final = (105, 115, 135)
CABLE_RADIUS: Final = 0.025
"""Metres; thicker than a real cable, to be visible in a scene of fifty metres."""

FAST_PERIOD: Final = 0.2
"""Seconds between updates of colours, trails and margins."""

SLOW_PERIOD: Final = 1.0
"""Seconds between updates of batteries, links and the tightest distance."""


def log_plan(stream: rr.RecordingStream, plan: Plan) -> None:
    """Log the static entities: axes, workspace, pads, path, folded knot and its crossings."""

    def static(entity: str | list[str], *components: rr.AsComponents) -> None:
        stream.log(entity, *components, static=True)

    vehicles = plan.mission.vehicles
    static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    _log_wind(static, plan)
    for name, lines in scene.workspace_lines(plan).items():
        static([name], rr.LineStrips3D(lines, radii=0.015, colors=(200, 90, 60)))
    pads = plan.motion.at(plan.motion.times[0])[0] * [1.0, 1.0, 0.0]
    static(
        "pads",
        rr.Cylinders3D(
            centers=pads,
            radii=[1.2 * vehicles.radius] * len(pads),
            lengths=[0.01] * len(pads),
            colors=(95, 105, 125),
            fill_mode="solid",
        ),
    )
    if len(plan.path) > 1:
        static("plan/path", rr.LineStrips3D([plan.path], radii=0.012, colors=PATH_COLOUR))
    knot = scene.strands(plan.layout.corners, plan.layout.lengths, scene.POINTS_PER_SEGMENT)
    static("plan/knot", rr.LineStrips3D(knot, radii=0.012, colors=PLAN_COLOUR))
    crossings = scene.crossings(plan.layout)
    pairs = np.array([[crossing.lower, crossing.upper] for crossing in crossings]).reshape(-1, 2, 3)
    static("plan/crossings", rr.LineStrips3D(pairs, radii=0.012, colors=(255, 255, 255)))
    static(
        "plan/crossings/labels",
        rr.Points3D(
            pairs.mean(axis=1),
            radii=0.02,
            colors=(255, 255, 255),
            labels=[f"{c.over} over {c.under}: {c.distance:.2f} m" for c in crossings],
            show_labels=True,
        ),
    )


def _log_wind(static: Callable[..., None], plan: Plan) -> None:
    """Log an arrow for the wind of the mission, which may come from any side."""
    wind = plan.mission.wind
    if wind.steady + wind.gust <= 0.0:
        return
    low = plan.layout.corners.min(axis=0)
    static(
        "wind",
        rr.Arrows3D(
            origins=[low - np.array([1.5, 1.5, 0.0])],
            vectors=[[0.5 * (wind.steady + wind.gust), 0.0, 0.0]],
            radii=0.04,
            colors=(140, 200, 255),
            labels=[f"wind {wind.steady:g} m/s, gusts {wind.gust:g} m/s, from any side"],
            show_labels=True,
        ),
    )


def quadrotor(radius: float, grip_offset: float) -> rr.Mesh3D:
    """Return the mesh of a quadrotor around its centre: arms, four rotors, dropper to its grip."""
    angles = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(16)])
    fan = np.stack([np.zeros(16, int), 1 + np.arange(16), 1 + (np.arange(16) + 1) % 16], axis=1)
    points: list[Floats] = []
    triangles: list[npt.NDArray[np.int_]] = []
    colours: list[npt.NDArray[np.uint8]] = []

    def add(vertices: Floats, faces: npt.NDArray[np.int_], colour: tuple[int, int, int]) -> None:
        triangles.append(faces + sum(len(p) for p in points))
        points.append(vertices)
        colours.append(np.tile(np.array(colour, np.uint8), (len(vertices), 1)))

    box = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    sides = np.array(faces)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    for turn in np.pi / 4 + np.pi / 2 * np.arange(4):
        hub = 0.6 * radius * np.array([np.cos(turn), np.sin(turn), 0.0])
        disc = np.vstack([[np.zeros(3)], rim]) * 0.4 * radius + hub + [0.0, 0.0, 0.05 * radius]
        add(disc, fan, (205, 212, 225))
        if turn < np.pi:
            across = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            arm = box * [1.2 * radius, 0.1 * radius, 0.08 * radius]
            arm[:, :2] = arm[:, :2] @ across.T
            add(arm, sides, (90, 96, 110))
    if grip_offset > 0:
        rod = box * [0.06 * radius, 0.06 * radius, grip_offset] - [0.0, 0.0, 0.5 * grip_offset]
        add(rod, sides, (150, 156, 170))
    return rr.Mesh3D(
        vertex_positions=np.concatenate(points),
        triangle_indices=np.concatenate(triangles),
        vertex_colors=np.concatenate(colours),
        face_rendering="DoubleSided",
    )


class Recorder:
    """Logs a live flight with the same few calls to Rerun for any number of vehicles."""

    def __init__(self, stream: rr.RecordingStream, plan: Plan) -> None:
        self._stream = stream
        self._plan = plan
        self._limit = plan.mission.vehicles.tracking
        self._above = np.array([0.0, 0.0, plan.mission.vehicles.grip_offset])
        self._held = laid_grip_points(plan)
        self._gripped = np.zeros(plan.vehicles, dtype=bool)
        self._trail = np.full((plan.vehicles, 3), np.nan)
        self._strips = scene.strands(self._held, plan.layout.lengths, scene.POINTS_PER_SEGMENT)
        self._shape_logged = False
        self._appearance: object = None
        self._states: dict[str, str] = {}
        self._next: dict[float, float] = {}
        self._counts = np.zeros((2, plan.vehicles))
        self._curves = CurveBuffer(stream)
        log_plan(stream, plan)
        self._log_styles()

    def snapshot(self, snapshot: Snapshot) -> None:
        """Log a snapshot of the team at its time.

        Positions are logged every time; colours of the cable, trails and slow values less often.
        """
        self._stream.set_time("time", duration=snapshot.time)
        self._stream.set_time("mission_time", duration=snapshot.mission_time)
        fast = self._due(FAST_PERIOD, snapshot.time)
        self._log_vehicles(snapshot)
        self._log_cable(snapshot, colours=fast)
        self._draw("error", snapshot, scene.tracking_errors(snapshot))
        if fast:
            self._log_trails(snapshot)
            self._draw("rate", snapshot, snapshot.rate)
            age = snapshot.link_age
            self._draw("link", snapshot, np.where(np.isfinite(age), age, np.nan))
            self._log_margins(snapshot)
        if self._due(SLOW_PERIOD, snapshot.time):
            self._log_tightest(snapshot)
            self._draw("battery", snapshot, 100.0 * snapshot.battery)
            self._log_links(snapshot)
            self._draw("error/limit", snapshot, self._limit)
            self._draw("link/limit", snapshot, scene.SILENT_AFTER)
        self._curves.send_due(snapshot.time)
        self._log_state("states/phase", snapshot.phase)
        self._log_state("states/gate", snapshot.held or snapshot.waiting_for or "–")

    def event(self, event: Event) -> None:
        """Log an event."""
        log_event(self._stream, event)

    def finish(self) -> None:
        """Send the last points of the curves."""
        self._curves.send()

    def _draw(self, curve: str, snapshot: Snapshot, values: npt.ArrayLike) -> None:
        self._curves.add(f"plots/{curve}", snapshot.time, snapshot.mission_time, values)

    def _log_styles(self) -> None:
        n = self._plan.vehicles
        vehicles = self._plan.mission.vehicles
        names = [f"vehicle {i + 1}" for i in range(n)]
        colours = vehicle_colours(n)
        log = self._stream.log
        log_style(self._stream, "flight", vehicles.radius)
        ghost = rr.Points3D.from_fields(radii=[0.05], colors=[GHOST_COLOUR])
        log("flight/setpoints", ghost, static=True)
        for quantity in ("error", "battery", "link", "round_trip", "loss"):
            log(
                f"plots/{quantity}",
                rr.SeriesLines(names=names, colors=colours, widths=[1.5] * n),
                static=True,
            )
        segments = [f"segment {i + 1}" for i in range(n - 1)]
        if segments:
            swings = rr.SeriesLines(names=segments, colors=colours[:-1], widths=[1.5] * (n - 1))
            log("plots/swing", swings, static=True)
        limits = (
            ("error/limit", f"tracking radius {self._limit:g} m"),
            ("link/limit", f"silent after {scene.SILENT_AFTER:g} s"),
        )
        for entity, name in limits:
            log(
                f"plots/{entity}",
                rr.SeriesLines(names=name, colors=(255, 80, 80), widths=2.0),
                static=True,
            )
        margins = rr.SeriesLines(
            names=["cable to cable", "vehicle to vehicle"],
            colors=[(70, 200, 190), (245, 205, 80)],
            widths=[2.0, 2.0],
        )
        log("plots/margin", margins, static=True)
        zero = rr.SeriesLines(names="no margin", colors=(255, 80, 80), widths=2.0)
        log("plots/margin/limit", zero, static=True)
        log(
            "plots/rate",
            rr.SeriesLines(names="mission clock rate", colors=(120, 200, 255), widths=2.0),
            static=True,
        )
        states = rr.StateConfiguration(
            values=list(scene.STATE_COLOURS),
            colors=[(*colour, 255) for colour in scene.STATE_COLOURS.values()],
        )
        for i in range(n):
            log(state_entity("vehicles", i, n), states, static=True)

    def _due(self, period: float, now: float) -> bool:
        due = now >= self._next.get(period, -np.inf)
        if due:
            self._next[period] = now + 0.99 * period
        return due

    def _log_vehicles(self, snapshot: Snapshot) -> None:
        log = self._stream.log
        allowed = scene.allowed_error(self._plan, snapshot.mission_time)
        states = scene.vehicle_states(snapshot, allowed)
        known = np.isfinite(snapshot.position).all(axis=-1)
        aimed = known & np.isfinite(snapshot.setpoint).all(axis=-1)
        centres = (snapshot.position + self._above)[known]
        if known.any() and not self._shape_logged:
            # A shape without a position would be drawn at the origin.
            self._shape_logged = True
            size = self._plan.mission.vehicles
            log("flight/vehicles", quadrotor(size.radius, size.grip_offset))
        log("flight/vehicles", rr.InstancePoses3D(translations=centres))
        log("flight/marks", rr.Points3D.from_fields(positions=centres))
        ghosts = (snapshot.setpoint + self._above)[aimed]
        log("flight/setpoints", rr.Points3D.from_fields(positions=ghosts))
        appearance = (states, snapshot.modes, known.tolist())
        if appearance == self._appearance:
            return
        self._appearance = appearance
        colours = np.array([scene.STATE_COLOURS[state] for state in states], np.uint8)
        labels = [str(i + 1) for i in np.flatnonzero(known)]
        log("flight/marks", rr.Points3D.from_fields(colors=colours[known], labels=labels))
        for i, (mode, state) in enumerate(zip(snapshot.modes, states, strict=True)):
            self._log_state(state_entity("vehicles", i, len(states)), state)
            self._log_state(state_entity("modes", i, len(states)), mode or "unknown")

    def _log_trails(self, snapshot: Snapshot) -> None:
        pair = np.stack([self._trail, snapshot.position], axis=1)
        moved = np.isfinite(pair).all(axis=(1, 2))
        colours = vehicle_colours(len(moved))[moved]
        self._stream.log("flight/trails", rr.LineStrips3D(pair[moved], colors=colours, radii=0.012))
        self._trail = snapshot.position

    def _log_cable(self, snapshot: Snapshot, colours: bool) -> None:
        lengths = self._plan.layout.lengths
        self._held, self._gripped = scene.follow_grips(self._held, self._gripped, snapshot)
        self._strips = scene.shown_strands(
            snapshot, self._held, self._gripped, lengths, scene.POINTS_PER_SEGMENT
        )
        tints = scene.tautness_colours(scene.tautness(self._held, lengths)) if colours else None
        self._stream.log(
            "flight/cable", rr.LineStrips3D.from_fields(strips=self._strips, colors=tints)
        )

    def _log_margins(self, snapshot: Snapshot) -> None:
        clearances, required = snapshot.clearances, self._plan.mission.clearance
        if clearances is not None:
            margins = np.array(
                [clearances.cable - required.cable, clearances.vehicle - required.vehicle]
            )
            margins[~np.isfinite(margins)] = np.nan
            self._draw("margin", snapshot, margins)
            self._draw("margin/limit", snapshot, 0.0)
        if snapshot.stray is not None:
            self._draw("swing", snapshot, snapshot.stray)
        for command, (possible, _) in snapshot.available.items():
            self._log_state(f"states/windows/{command}", "open" if possible else "closed")

    def _log_links(self, snapshot: Snapshot) -> None:
        """Log the latest round trips, and the share of packets lost since the last update."""
        if not len(snapshot.received):
            return
        self._draw("round_trip", snapshot, 1e3 * snapshot.round_trip)
        counts = np.stack([snapshot.received, snapshot.lost])
        received, lost = counts - self._counts
        self._counts = counts
        share = 100.0 * lost / np.maximum(received + lost, 1.0)
        self._draw("loss", snapshot, share)

    def _log_tightest(self, snapshot: Snapshot) -> None:
        aloft = self._plan.phase("fold").start <= snapshot.mission_time
        closest = scene.closest_strands(self._strips) if aloft and self._gripped.all() else None
        if closest is None:
            self._stream.log("flight/tightest", rr.Clear(recursive=False))
            return
        distance, ends = closest
        distance -= self._plan.mission.cable.diameter
        line = rr.LineStrips3D(
            [ends], radii=0.02, colors=(255, 90, 90), labels=f"{distance:.2f} m", show_labels=True
        )
        self._stream.log("flight/tightest", line)

    def _log_state(self, entity: str, state: str) -> None:
        if self._states.get(entity) != state:
            self._states[entity] = state
            self._stream.log(entity, rr.StateChange(state=state))


def log_event(stream: rr.RecordingStream, event: Event) -> None:
    """Log an event at its time."""
    stream.set_time("time", duration=event.time)
    text = f"{clock(event.time)}  {event_text(event)}"
    stream.log("log", rr.TextLog(text, level=log_level(event)))


def log_style(stream: rr.RecordingStream, entity: str, radius: float) -> None:
    """Log the sizes of a team's marks and cable below ``entity``."""
    marks = rr.Points3D.from_fields(radii=[0.35 * radius], show_labels=True)
    stream.log(f"{entity}/marks", marks, static=True)
    stream.log(f"{entity}/cable", rr.LineStrips3D.from_fields(radii=[CABLE_RADIUS]), static=True)


def state_entity(kind: str, vehicle: int, count: int) -> str:
    """Return the entity of a vehicle's states; padded numbers keep the entities in order."""
    return f"states/{kind}/{vehicle + 1:0{len(str(count))}d}"


def vehicle_colours(count: int) -> npt.NDArray[np.uint8]:
    """Return one colour per vehicle (count, 3) for curves: neighbours along the cable differ."""
    hue = np.mod(np.arange(count, dtype=np.float64) * 0.61803398875, 1.0)
    return _hsv(hue, 0.55, 0.95)


def _hsv(hue: Floats, saturation: float, value: float) -> npt.NDArray[np.uint8]:
    k = np.mod(np.array([5.0, 3.0, 1.0]) + 6.0 * hue[:, None], 6.0)
    mixed = value - value * saturation * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0)
    return (255.0 * mixed).astype(np.uint8)
