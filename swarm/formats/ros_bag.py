"""Samples as a ROS 2 bag: a folder with an MCAP file of ROS messages and ``metadata.yaml``."""

from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore

from swarm.errors import InputError, Problem, reason
from swarm.files import replaced
from swarm.formats.samples import CABLE_POINTS, CABLE_WIDTH, FRAME, Samples
from swarm.reports import scene

Floats = npt.NDArray[np.float64]

_TYPES = get_typestore(Stores.ROS2_JAZZY)
_POSE = "geometry_msgs/msg/PoseStamped"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_TEXT = "std_msgs/msg/String"
_MARKER = "visualization_msgs/msg/Marker"


def write_bag(samples: Samples, path: Path) -> None:
    """Write samples as a new ROS 2 bag (Jazzy); raise :class:`InputError` where that fails.

    ``/vehicle_1/position``… and ``/vehicle_1/setpoint``… (geometry_msgs/PoseStamped) are grip
    points, ``/tf`` has a frame ``vehicle_1``… at the centre of every vehicle, ``/cable``
    (visualization_msgs/Marker) is the cable, ``/phase`` (std_msgs/String) the phase. Unknown places
    are left out; attitudes are upright.
    """
    if path.exists():
        raise InputError([Problem(str(path), "file exists")])
    kind = {"version": Writer.VERSION_LATEST, "storage_plugin": StoragePlugin.MCAP}
    try:
        with replaced(path) as new, Writer(new, **kind) as bag:
            _write(samples, bag)
    except WriterError as error:
        raise InputError([Problem(str(path), reason(error))]) from None


def _write(samples: Samples, bag: Any) -> None:
    def topic(name: str, kind: str) -> Any:
        return bag.add_connection(name, kind, typestore=_TYPES)

    transforms, phase = topic("/tf", _TRANSFORMS), topic("/phase", _TEXT)
    cable = topic("/cable", _MARKER)
    places = {
        (name, k): topic(f"/vehicle_{k + 1}/{name}", _POSE)
        for name in ("position", "setpoint")
        if name in samples.vectors
        for k in range(samples.vehicles)
    }

    def add(connection: Any, stamp: int, message: Any) -> None:
        bag.write(connection, stamp, _TYPES.serialize_cdr(message, connection.msgtype))

    moments = zip(samples.stamps, samples.centres, strict=True)
    for i, (stamp, centres) in enumerate(moments):
        add(phase, stamp, _message(_TEXT, data=samples.phase[i]))
        add(transforms, stamp, _message(_TRANSFORMS, transforms=_transforms(stamp, centres)))
        add(cable, stamp, _cable(samples, i, stamp))
        for (name, k), connection in places.items():
            place = samples.vectors[name][i, k]
            if np.isfinite(place).all():
                pose = _message(
                    "geometry_msgs/msg/Pose",
                    position=_xyz("geometry_msgs/msg/Point", place),
                    orientation=_upright(),
                )
                add(connection, stamp, _message(_POSE, header=_header(stamp), pose=pose))


def _message(kind: str, **fields: Any) -> Any:
    return _TYPES.types[kind](**fields)


def _header(stamp: int) -> Any:
    time = _message("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return _message("std_msgs/msg/Header", stamp=time, frame_id=FRAME)


def _xyz(kind: str, place: Floats) -> Any:
    x, y, z = place.tolist()
    return _message(kind, x=x, y=y, z=z)


def _upright() -> Any:
    return _message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)


def _transforms(stamp: int, centres: Floats) -> list[Any]:
    return [
        _message(
            "geometry_msgs/msg/TransformStamped",
            header=_header(stamp),
            child_frame_id=f"vehicle_{k + 1}",
            transform=_message(
                "geometry_msgs/msg/Transform",
                translation=_xyz("geometry_msgs/msg/Vector3", centre),
                rotation=_upright(),
            ),
        )
        for k, centre in enumerate(centres)
        if isfinite(centre.sum())
    ]


def _cable(samples: Samples, i: int, stamp: int) -> Any:
    """Return the segments of the cable with a known shape as a list of lines."""
    shapes = scene.strands(samples.cable[i], samples.lengths, CABLE_POINTS)
    shapes = shapes[np.isfinite(shapes).all(axis=(1, 2))]
    pieces = np.stack([shapes[:, :-1], shapes[:, 1:]], axis=2).reshape(-1, 3)
    points = [_xyz("geometry_msgs/msg/Point", point) for point in pieces]
    marker = _TYPES.types[_MARKER]
    origin, nothing = np.zeros(3), np.zeros(0, np.uint8)
    colour = _message("std_msgs/msg/ColorRGBA", r=0.27, g=0.78, b=0.75, a=1.0)
    image = "sensor_msgs/msg/CompressedImage"
    return marker(
        header=_header(stamp),
        ns="cable",
        id=0,
        type=marker.LINE_LIST,
        action=marker.ADD if points else marker.DELETE,
        pose=_message(
            "geometry_msgs/msg/Pose",
            position=_xyz("geometry_msgs/msg/Point", origin),
            orientation=_upright(),
        ),
        scale=_xyz("geometry_msgs/msg/Vector3", np.array([CABLE_WIDTH, 0.0, 0.0])),
        color=colour,
        lifetime=_message("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=points,
        colors=[],
        texture_resource="",
        texture=_message(image, header=_header(stamp), format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_message("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )
