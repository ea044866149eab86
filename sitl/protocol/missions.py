"""The mission protocol: upload, read back, clear; missions, fences and rally points.

`sitl.autopilots.mission_flight` flies missions, `sitl.protocol.fences` reads fences; rally points
are stored only.
"""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from sitl.protocol import fences
from sitl.protocol.links import Link
from sitl.protocol.vehicle import Vehicle, addressed, scaled_degrees

_MISSION_TIMEOUT = 5.0
_LARGEST_MISSION = 500


def _send_count(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        kind = message.mission_type
        v.send(
            "MISSION_COUNT",
            link,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
            count=len(v.mission.get(kind, [])),
            mission_type=kind,
        )


def _send_item(v: Vehicle, message: Any, link: Link) -> None:
    if not addressed(v, message):
        return
    items = v.mission.get(message.mission_type, [])
    if message.seq >= len(items):
        _acknowledge(v, message, link, dialect.MAV_MISSION_INVALID_SEQUENCE)
        return
    item = dict(items[message.seq])
    item["target_system"], item["target_component"] = (
        message.get_srcSystem(),
        message.get_srcComponent(),
    )
    if message.get_type() == "MISSION_REQUEST_INT":
        v.send("MISSION_ITEM_INT", link, **item)
    else:
        item["x"], item["y"] = item["x"] * 1e-7, item["y"] * 1e-7
        v.send("MISSION_ITEM", link, **item)


def _acknowledge(v: Vehicle, message: Any, link: Link, result: int) -> None:
    v.send(
        "MISSION_ACK",
        link,
        target_system=message.get_srcSystem(),
        target_component=message.get_srcComponent(),
        type=result,
        mission_type=message.mission_type,
    )


def _start_upload(v: Vehicle, message: Any, link: Link) -> None:
    if not addressed(v, message):
        return
    kind = message.mission_type
    if kind not in v.mission or message.count > _LARGEST_MISSION:
        _acknowledge(v, message, link, dialect.MAV_MISSION_NO_SPACE)
    elif message.count == 0:
        _acknowledge(v, message, link, _store(v, kind, []))
    else:
        v.upload = {"kind": kind, "count": message.count, "items": [], "at": v.now}
        _request_item(v, message, link)


def _request_item(v: Vehicle, message: Any, link: Link) -> None:
    v.send(
        "MISSION_REQUEST_INT",
        link,
        target_system=message.get_srcSystem(),
        target_component=message.get_srcComponent(),
        seq=len(v.upload["items"]),
        mission_type=v.upload["kind"],
    )


_ITEM_FIELDS = (
    "seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4",
    "x", "y", "z", "mission_type",
)  # fmt: skip


def _receive_item(v: Vehicle, message: Any, link: Link) -> None:
    if not addressed(v, message):
        return
    upload = v.upload
    if not upload or v.now - upload["at"] > _MISSION_TIMEOUT:
        _acknowledge(v, message, link, dialect.MAV_MISSION_ERROR)
        return
    if message.seq != len(upload["items"]):
        _request_item(v, message, link)
        return
    item = {name: getattr(message, name) for name in _ITEM_FIELDS}
    if message.get_type() == "MISSION_ITEM":
        item["x"], item["y"] = scaled_degrees(item["x"]), scaled_degrees(item["y"])
    upload["items"].append(item)
    upload["at"] = v.now
    if len(upload["items"]) < upload["count"]:
        _request_item(v, message, link)
        return
    v.upload = {}
    result = _store(v, upload["kind"], upload["items"])
    _acknowledge(v, message, link, result)


def _store(v: Vehicle, kind: int, items: list[dict[str, Any]]) -> int:
    """Store a complete list; return the MAV_MISSION_RESULT."""
    if kind == dialect.MAV_MISSION_TYPE_FENCE:
        fence = fences.areas(items, v.environment.geodesy)
        if fence is None:
            return int(dialect.MAV_MISSION_ERROR)
        v.fence = fence
    v.mission[kind] = items
    if kind == dialect.MAV_MISSION_TYPE_MISSION:
        v.mission_progress.restart()
    return int(dialect.MAV_MISSION_ACCEPTED)


def _set_current(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message) and v.mission_progress.jump_to(message.seq, len(v.mission[0])):
        v.send("MISSION_CURRENT", link, seq=message.seq)


def _clear(v: Vehicle, message: Any, link: Link) -> None:
    if addressed(v, message):
        kinds = list(v.mission) if message.mission_type == 255 else [message.mission_type]
        for kind in set(kinds) & set(v.mission):
            _store(v, kind, [])
        _acknowledge(v, message, link, dialect.MAV_MISSION_ACCEPTED)


HANDLERS: dict[str, Callable[[Vehicle, Any, Link], None]] = {
    "MISSION_REQUEST_LIST": _send_count,
    "MISSION_REQUEST": _send_item,
    "MISSION_REQUEST_INT": _send_item,
    "MISSION_COUNT": _start_upload,
    "MISSION_ITEM": _receive_item,
    "MISSION_ITEM_INT": _receive_item,
    "MISSION_SET_CURRENT": _set_current,
    "MISSION_CLEAR_ALL": _clear,
}
