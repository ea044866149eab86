"""The mission protocol: missions, fences and rally points are uploaded and read back.

Fences count. Missions and rally points are stored only: no mission can be started.
"""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from sitl.protocol import missions
from sitl.protocol.vehicle import Vehicle, scaled_degrees
from sitl.protocol.wire import Link

_MISSION_TIMEOUT = 5.0
_LARGEST_MISSION = 500


def _send_count(v: Vehicle, message: Any, link: Link) -> None:
    kind = message.mission_type
    v.answer("MISSION_COUNT", message, link, count=len(v.mission.get(kind, [])), mission_type=kind)


def _send_item(v: Vehicle, message: Any, link: Link) -> None:
    items = v.mission.get(message.mission_type, [])
    if message.seq >= len(items):
        _acknowledge(v, message, link, dialect.MAV_MISSION_INVALID_SEQUENCE)
        return
    item = dict(items[message.seq])
    if message.get_type() == "MISSION_REQUEST_INT":
        v.answer("MISSION_ITEM_INT", message, link, **item)
    else:
        item["x"], item["y"] = item["x"] * 1e-7, item["y"] * 1e-7
        v.answer("MISSION_ITEM", message, link, **item)


def _acknowledge(v: Vehicle, message: Any, link: Link, result: int) -> None:
    v.answer("MISSION_ACK", message, link, type=result, mission_type=message.mission_type)


def _start_upload(v: Vehicle, message: Any, link: Link) -> None:
    kind = message.mission_type
    if kind not in v.mission or message.count > _LARGEST_MISSION:
        _acknowledge(v, message, link, dialect.MAV_MISSION_NO_SPACE)
    elif message.count == 0:
        _acknowledge(v, message, link, _store(v, kind, []))
    else:
        v.upload = {"kind": kind, "count": message.count, "items": [], "at": v.now}
        _request_item(v, message, link)


def _request_item(v: Vehicle, message: Any, link: Link) -> None:
    seq, kind = len(v.upload["items"]), v.upload["kind"]
    v.answer("MISSION_REQUEST_INT", message, link, seq=seq, mission_type=kind)


_ITEM_FIELDS = (
    "seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4",
    "x", "y", "z", "mission_type",
)  # fmt: skip


def _receive_item(v: Vehicle, message: Any, link: Link) -> None:
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
        fence = missions.areas(items, v.environment.geodesy)
        if fence is None:
            return int(dialect.MAV_MISSION_ERROR)
        v.fence = fence
    v.mission[kind] = items
    return int(dialect.MAV_MISSION_ACCEPTED)


def _clear(v: Vehicle, message: Any, link: Link) -> None:
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
    "MISSION_CLEAR_ALL": _clear,
}
