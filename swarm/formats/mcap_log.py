"""Samples as an MCAP log for Foxglove and PlotJuggler.

Pictures, frames and events are messages of Foxglove's own Protobuf schemas, figures are JSON.
"""

import json
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from swarm.files import replaced
from swarm.flight.snapshot import Event
from swarm.formats.samples import CABLE_POINTS, CABLE_WIDTH, FRAME, Samples, nanoseconds
from swarm.reports import scene
from swarm.version import __version__

Floats = npt.NDArray[np.float64]

_HEIGHT = 0.06
"""Height in metres of the disc that stands for a vehicle."""
_LABEL_SIZE = 0.25
"""Height in metres of a vehicle's number."""
_VEHICLE = Color(r=0.34, g=0.63, b=1.0, a=1.0)
_UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def write_log(samples: Samples, path: Path) -> None:
    """Write samples as an MCAP log; raise :class:`InputError` where that fails.

    ``/scene`` (foxglove.SceneUpdate) shows vehicles and cable; ``/tf`` (foxglove.FrameTransforms)
    has a frame ``vehicle_1``… at the centre of every vehicle; ``/events`` (foxglove.Log) has the
    events; ``/mission`` and ``/vehicle_1/state``… (JSON) have the figures, without unknown ones.
    """
    with replaced(path) as new, new.open("wb") as file:
        _write(samples, file)


def _write(samples: Samples, file: IO[bytes]) -> None:
    writer = Writer(file)
    writer.start(profile="", library=f"swarm {__version__}")
    writer.add_metadata("swarm", {"mission": json.dumps(samples.mission.document())})
    scenes = _protobuf(writer, "/scene", SceneUpdate)
    frames = _protobuf(writer, "/tf", FrameTransforms)
    mission = _figures_channel(writer, "/mission", _mission_schema())
    state = _state_schema(samples)
    states = [
        _figures_channel(writer, f"/vehicle_{k + 1}/state", state) for k in range(samples.vehicles)
    ]
    centres = samples.centres
    for k, (stamp, update) in enumerate(zip(samples.stamps, _scenes(samples), strict=True)):
        _add(writer, scenes, stamp, update.SerializeToString())
        _add(writer, frames, stamp, _transforms(centres[k], stamp).SerializeToString())
        clock = {"mission_time": samples.mission_time[k], "phase": samples.phase[k]}
        _add(writer, mission, stamp, json.dumps(clock).encode())
        for vehicle, channel in enumerate(states):
            _add(writer, channel, stamp, json.dumps(_state(samples, k, vehicle)).encode())
    if samples.events:
        channel = _protobuf(writer, "/events", Log)
        for event in samples.events:
            stamp = nanoseconds(samples.started + event.time)
            _add(writer, channel, stamp, _log(event, stamp).SerializeToString())
    writer.finish()


def _protobuf(writer: Writer, topic: str, message: Any) -> int:
    schema = register_schema(writer, message)
    return int(writer.register_channel(topic, MessageEncoding.Protobuf, schema))


def _figures_channel(writer: Writer, topic: str, properties: dict[str, Any]) -> int:
    document = json.dumps({"type": "object", "properties": properties}).encode()
    name = "swarm.Mission" if topic == "/mission" else "swarm.VehicleState"
    schema = writer.register_schema(name, SchemaEncoding.JSONSchema, document)
    return int(writer.register_channel(topic, MessageEncoding.JSON, schema))


def _add(writer: Writer, channel: int, stamp: int, data: bytes) -> None:
    writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)


def _mission_schema() -> dict[str, Any]:
    return {"mission_time": {"type": "number"}, "phase": {"type": "string"}}


def _state_schema(samples: Samples) -> dict[str, Any]:
    number = {"type": "number"}
    vector = {"type": "object", "properties": dict.fromkeys("xyz", number)}
    return dict.fromkeys(samples.vectors, vector) | dict.fromkeys(samples.scalars, number)


def _state(samples: Samples, k: int, vehicle: int) -> dict[str, Any]:
    """Return the known figures of a vehicle at a moment; JSON has no NaN."""
    vectors = {name: values[k, vehicle] for name, values in samples.vectors.items()}
    scalars = {name: float(values[k, vehicle]) for name, values in samples.scalars.items()}
    known: dict[str, Any] = {
        name: dict(zip("xyz", vector.tolist(), strict=True))
        for name, vector in vectors.items()
        if np.isfinite(vector).all()
    }
    return known | {name: value for name, value in scalars.items() if isfinite(value)}


def _timestamp(stamp: int) -> Timestamp:
    return Timestamp(seconds=stamp // 10**9, nanos=stamp % 10**9)


def _transforms(centres: Floats, stamp: int) -> FrameTransforms:
    """Return the frames of the vehicles with a known place, upright: attitudes are not known."""
    transforms = [
        FrameTransform(
            timestamp=_timestamp(stamp),
            parent_frame_id=FRAME,
            child_frame_id=f"vehicle_{vehicle}",
            translation=Vector3(x=x, y=y, z=z),
            rotation=_UPRIGHT,
        )
        for vehicle, (x, y, z) in enumerate(centres.tolist(), start=1)
        if isfinite(x + y + z)
    ]
    return FrameTransforms(transforms=transforms)


def _scenes(samples: Samples) -> Iterator[SceneUpdate]:
    """Yield the scene at every moment: the vehicles, and the cable coloured by its tautness."""
    colours = scene.tautness_colours(scene.tautness(samples.cable, samples.lengths)) / 255.0
    centres = samples.centres
    for k, stamp in enumerate(samples.stamps):
        shapes = scene.strands(samples.cable[k], samples.lengths, CABLE_POINTS)
        entities = [_entity("vehicles", stamp, *_vehicles(samples, centres[k]))]
        entities.append(_entity("cable", stamp, lines=_cable(shapes, colours[k])))
        yield SceneUpdate(entities=entities)


def _entity(name: str, stamp: int, cylinders: Any = (), texts: Any = (), lines: Any = ()) -> Any:
    return SceneEntity(
        timestamp=_timestamp(stamp), frame_id=FRAME, id=name,
        cylinders=cylinders, texts=texts, lines=lines,
    )  # fmt: skip


def _vehicles(samples: Samples, centres: Floats) -> tuple[list[Any], list[Any]]:
    """Return a disc of the rotors' radius and a number for each vehicle with a known place."""
    width = 2.0 * samples.mission.vehicles.radius
    discs, numbers = [], []
    for vehicle, (x, y, z) in enumerate(centres.tolist(), start=1):
        if not isfinite(x + y + z):
            continue
        place = Pose(position=Vector3(x=x, y=y, z=z), orientation=_UPRIGHT)
        size = Vector3(x=width, y=width, z=_HEIGHT)
        discs.append(
            CylinderPrimitive(pose=place, size=size, bottom_scale=1, top_scale=1, color=_VEHICLE)
        )
        above = Pose(position=Vector3(x=x, y=y, z=z + _LABEL_SIZE), orientation=_UPRIGHT)
        white = Color(r=1.0, g=1.0, b=1.0, a=1.0)
        numbers.append(
            TextPrimitive(
                pose=above, billboard=True, font_size=_LABEL_SIZE, color=white, text=str(vehicle)
            )
        )
    return discs, numbers


def _cable(shapes: Floats, colours: Floats) -> list[LinePrimitive]:
    """Return the segments of the cable with a known shape as lines."""
    return [
        LinePrimitive(
            type=LinePrimitive.LINE_STRIP,
            pose=Pose(orientation=_UPRIGHT),
            thickness=CABLE_WIDTH,
            points=[Point3(x=x, y=y, z=z) for x, y, z in shape.tolist()],
            color=Color(r=colour[0], g=colour[1], b=colour[2], a=1.0),
        )
        for shape, colour in zip(shapes, colours, strict=True)
        if np.isfinite(shape).all()
    ]


def _log(event: Event, stamp: int) -> Log:
    name = f"vehicle {event.vehicle}" if event.vehicle else "team"
    message = f"{event.kind}: {event.message}"
    return Log(timestamp=_timestamp(stamp), level=Log.INFO, message=message, name=name)
