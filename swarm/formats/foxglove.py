"""A team over time as messages for Foxglove and PlotJuggler, in an MCAP log or live.

Pictures, frames and events are messages of Foxglove's own schemas, figures are JSON. The library
passes each message to all sinks of a context: a log, a server, or both.
"""

import json
from collections.abc import Mapping, Sequence
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import numpy.typing as npt
from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.mcap import MCAPWriteOptions
from foxglove.messages import (
    Color,
    CylinderPrimitive,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from swarm.files import replaced
from swarm.flight.snapshot import Event
from swarm.formats.samples import CABLE_POINTS, CABLE_WIDTH, FRAME, Samples, nanoseconds
from swarm.mission import Mission
from swarm.planning import Plan
from swarm.reports import scene
from swarm.reports.formatting import log_level

Floats = npt.NDArray[np.float64]
Figures = Mapping[str, Any]

_HEIGHT = 0.06
"""Height in metres of the disc that stands for a vehicle."""
_LABEL_SIZE = 0.25
"""Height in metres of a vehicle's number."""
_VEHICLE = Color(r=0.34, g=0.63, b=1.0, a=1.0)
_WHITE = Color(r=1.0, g=1.0, b=1.0, a=1.0)
_FENCE = Color(r=0.78, g=0.35, b=0.24, a=1.0)
_PAD = Color(r=0.37, g=0.41, b=0.49, a=1.0)
_UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)

_LEVELS = {"ERROR": LogLevel.Error, "WARN": LogLevel.Warning, "INFO": LogLevel.Info}

_NUMBER, _TEXT, _FLAG = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
_SCHEMA_OF = {float: _NUMBER, str: _TEXT, bool: _FLAG}
_VECTOR = {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)}


def write_log(samples: Samples, path: Path) -> None:
    """Write samples as an MCAP log; raise :class:`InputError` where that fails.

    Its topics are those of :class:`Messages`; ``/margins`` has none.
    """
    context = Context()
    with (
        replaced(path) as new,
        new.open("wb") as file,
        foxglove.open_mcap(file, context=context, writer_options=OPTIONS) as writer,
    ):
        writer.write_metadata("swarm", {"mission": json.dumps(samples.mission.document())})
        _send(Messages(context, samples.mission, samples.vehicles), samples)


OPTIONS = MCAPWriteOptions(compression_threads=0)
"""A thread more for each core would delay what else runs."""


def _send(messages: "Messages", samples: Samples) -> None:
    colours = scene.tautness_colours(scene.tautness(samples.cable, samples.lengths)) / 255.0
    for k, stamp in enumerate(samples.stamps):
        messages.frames(samples.centres[k], stamp)
        strands = scene.strands(samples.cable[k], samples.lengths, CABLE_POINTS)
        messages.scene(samples.centres[k], strands, colours[k], stamp)
        clock = {"mission_time": float(samples.mission_time[k]), "phase": samples.phase[k]}
        messages.mission(clock, stamp)
        for vehicle in range(samples.vehicles):
            vectors = {name: values[k, vehicle] for name, values in samples.vectors.items()}
            scalars = {name: float(values[k, vehicle]) for name, values in samples.scalars.items()}
            messages.vehicle(vehicle, vectors | scalars, stamp)
    for event in samples.events:
        messages.event(event, nanoseconds(samples.started + event.time))


class Messages:
    """The messages of a team of n vehicles, for the sinks of a context.

    ``/scene`` (foxglove.SceneUpdate) shows vehicles and cable; ``/tf`` (foxglove.FrameTransforms)
    has a frame ``vehicle_1``… at the centre of every vehicle; ``/events`` (foxglove.Log) has the
    events; ``/mission``, ``/margins`` and ``/vehicle_1/state``… (JSON) have the figures, without
    unknown ones. Stamps are nanoseconds since 1970, places are in metres, ENU.
    """

    def __init__(self, context: Context, mission: Mission, vehicles: int) -> None:
        self._context, self._radius = context, mission.vehicles.radius
        self._scene = SceneUpdateChannel("/scene", context=context)
        self._frames = FrameTransformsChannel("/tf", context=context)
        self._events = LogChannel("/events", context=context)
        self._figures: dict[str, Channel] = {}
        self._vehicles = [f"/vehicle_{k + 1}/state" for k in range(vehicles)]

    def field(self, plan: Plan, stamp: int) -> None:
        """Send what stands still: the pads and what bounds the workspace."""
        pads = plan.motion.at(plan.motion.times[0])[0] * [1.0, 1.0, 0.0]
        discs = [_disc(place, 1.2 * self._radius, 0.01, _PAD) for place in pads.tolist()]
        lines = chain.from_iterable(scene.workspace_lines(plan).values())
        bounds = [_line(line, _FENCE) for line in lines]
        self._entities([_entity("field", stamp, cylinders=discs, lines=bounds)], stamp)

    def scene(
        self, centres: Floats, strands: Floats, colours: Floats, stamp: int,
        states: Sequence[Color] | None = None,
    ) -> None:  # fmt: skip
        """Send vehicles at their centres (n, 3), and the cable's strands (n − 1, k, 3).

        ``colours`` (n − 1, 3) from 0 to 1 are those of the strands, ``states`` those of vehicles.
        What has no known place is not shown.
        """
        places = centres.tolist()
        tints = states or [_VEHICLE] * len(places)
        known = [k for k, place in enumerate(places) if isfinite(sum(place))]
        discs = [_disc(places[k], self._radius, _HEIGHT, tints[k]) for k in known]
        numbers = [_number(k + 1, places[k]) for k in known]
        lines = [
            _line(strand, Color(r=colour[0], g=colour[1], b=colour[2], a=1.0))
            for strand, colour in zip(strands, colours.tolist(), strict=True)
            if np.isfinite(strand).all()
        ]
        vehicles = _entity("vehicles", stamp, cylinders=discs, texts=numbers)
        self._entities([vehicles, _entity("cable", stamp, lines=lines)], stamp)

    def _entities(self, entities: list[SceneEntity], stamp: int) -> None:
        self._scene.log(SceneUpdate(entities=entities), log_time=stamp)

    def frames(self, centres: Floats, stamp: int) -> None:
        """Send frames at the centres (n, 3), upright: attitudes are not known."""
        transforms = [
            FrameTransform(
                timestamp=_timestamp(stamp),
                parent_frame_id=FRAME,
                child_frame_id=f"vehicle_{number}",
                translation=Vector3(x=x, y=y, z=z),
                rotation=_UPRIGHT,
            )
            for number, (x, y, z) in enumerate(centres.tolist(), start=1)
            if isfinite(x + y + z)
        ]
        self._frames.log(FrameTransforms(transforms=transforms), log_time=stamp)

    def event(self, event: Event, stamp: int) -> None:
        """Send an event."""
        name = f"vehicle {event.vehicle}" if event.vehicle else "team"
        message = f"{event.kind}: {event.message}"
        level = _LEVELS[log_level(event)]
        log = Log(timestamp=_timestamp(stamp), level=level, message=message, name=name)
        self._events.log(log, log_time=stamp)

    def mission(self, figures: Figures, stamp: int) -> None:
        """Send figures of the team."""
        self._send("/mission", "swarm.Mission", figures, stamp)

    def margins(self, figures: Figures, stamp: int) -> None:
        """Send distances and margins."""
        self._send("/margins", "swarm.Margins", figures, stamp)

    def vehicle(self, index: int, figures: Figures, stamp: int) -> None:
        """Send the figures of a vehicle, counted from 0: numbers, words, flags, vectors (3,)."""
        self._send(self._vehicles[index], "swarm.VehicleState", figures, stamp)

    def announce(self, mission: Figures, margins: Figures, vehicle: Figures) -> None:
        """Make the channels of figures like these, before a server begins.

        A viewer that subscribes at once to a channel that is made later is answered "Unknown
        channel ID", and never sees it (foxglove-sdk 0.30).
        """
        self._announce("/mission", "swarm.Mission", mission)
        self._announce("/margins", "swarm.Margins", margins)
        for topic in self._vehicles:
            self._announce(topic, "swarm.VehicleState", vehicle)

    def _announce(self, topic: str, name: str, figures: Figures) -> None:
        if topic not in self._figures:
            schema = {"type": "object", "title": name, "properties": _properties(figures)}
            self._figures[topic] = Channel(topic, schema=schema, context=self._context)

    def _send(self, topic: str, name: str, figures: Figures, stamp: int) -> None:
        """Send figures to a topic, whose schema has the announced ones, or those of its first
        message; JSON has no NaN."""
        self._announce(topic, name, figures)
        known = {key: value for key, value in figures.items() if _known(value)}
        shown = {
            key: dict(zip("xyz", value.tolist(), strict=True))
            if isinstance(value, np.ndarray)
            else value
            for key, value in known.items()
        }
        self._figures[topic].log(shown, log_time=stamp)


def _properties(figures: Figures) -> dict[str, Any]:
    return {key: _SCHEMA_OF.get(type(value), _VECTOR) for key, value in figures.items()}


def _known(value: Any) -> bool:
    return isinstance(value, str) or bool(np.isfinite(value).all())


def _timestamp(stamp: int) -> Timestamp:
    return Timestamp(sec=stamp // 10**9, nsec=stamp % 10**9)


def _entity(name: str, stamp: int, **primitives: Any) -> SceneEntity:
    return SceneEntity(timestamp=_timestamp(stamp), frame_id=FRAME, id=name, **primitives)


def _pose(x: float, y: float, z: float) -> Pose:
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=_UPRIGHT)


def _disc(place: Sequence[float], radius: float, height: float, colour: Color) -> CylinderPrimitive:
    size = Vector3(x=2.0 * radius, y=2.0 * radius, z=height)
    return CylinderPrimitive(
        pose=_pose(*place), size=size, bottom_scale=1.0, top_scale=1.0, color=colour
    )


def _number(number: int, place: Sequence[float]) -> TextPrimitive:
    x, y, z = place
    return TextPrimitive(
        pose=_pose(x, y, z + _LABEL_SIZE), billboard=True, font_size=_LABEL_SIZE, color=_WHITE,
        text=str(number),
    )  # fmt: skip


def _line(points: Floats, colour: Color) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=_pose(0.0, 0.0, 0.0),
        thickness=CABLE_WIDTH,
        points=[Point3(x=x, y=y, z=z) for x, y, z in points.tolist()],
        color=colour,
    )
