"""Comparison of the messages of two vehicles, field by field.

A recording of a real autopilot has both directions. `replay` sends the same packets at the same
times to an emulated vehicle; `facts` reduces the answers of either vehicle to named values, and
`differences` lists the values that differ.
"""

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.dialects.v20 import development

from sitl import Emulator
from tests.recordings.trim import GROUND, number
from tests.recordings.trim import target as addressed

Packets = Sequence[tuple[float, bytes]]
_STEP = 0.004
_FEW = 6
"""Up to this number, distinct values are compared one by one; more are "many"."""
_NEWER = {8: "LINK_NODE_STATUS", 380: "TIME_ESTIMATE_TO_TARGET", 397: "COMPONENT_METADATA",
          410: "EVENT", 411: "CURRENT_EVENT_SEQUENCE"}  # fmt: skip
"""Messages that the library cannot decode yet."""
dialect.mavlink_map.setdefault(436, development.mavlink_map[436])


@dataclass(frozen=True)
class Decoded:
    """A decoded message: time in seconds, name, fields."""

    at: float
    name: str
    fields: Mapping[str, Any]


def replay(
    emulator: Emulator, uplink: Packets, system: int, delay: float, end: float
) -> list[tuple[float, bytes]]:
    """Send the packets of a recording to an emulated vehicle, ``delay`` seconds later.

    Returns its packets until ``end``, with the times of the recording.
    """
    downlink: list[tuple[float, bytes]] = []
    queue = iter([*uplink, (math.inf, b"")])
    at, packet = next(queue)
    for k in range(1, math.ceil((end + delay) / _STEP) + 1):
        now = k * _STEP
        while at + delay <= now:
            emulator.receive(system, packet, now)
            at, packet = next(queue)
        for sender, data in emulator.step(now):
            if sender == system:
                downlink += [(now - delay, one) for one in _split(data) if now >= delay]
    return downlink


def _split(data: bytes) -> Iterator[bytes]:
    while data:
        length = 12 + data[1]
        yield data[:length]
        data = data[length:]


def to_vehicle(packets: Iterable[tuple[float, bytes]], system: int) -> list[tuple[float, bytes]]:
    """Return the ground station's packets to a vehicle."""
    return [
        (at, packet)
        for at, packet in packets
        if packet[5] == GROUND and packet[6] == 190 and addressed(packet) in {0, system}
    ]


def decoded(packets: Iterable[tuple[float, bytes]]) -> list[Decoded]:
    """Return packets with their fields by name; of the newest messages only the name."""
    reader = dialect.MAVLink(None)
    downlink = []
    for at, packet in packets:
        name = _NEWER.get(number(packet))
        if name is None:
            message = reader.decode(bytearray(packet))
            fields = message.to_dict()
            name = fields.pop("mavpackettype")
        else:
            fields = {}
        downlink.append(Decoded(at, name, fields))
    return downlink


def facts(
    downlink: Sequence[Decoded], uplink: Sequence[Decoded], skip: Iterable[str] = ()
) -> dict[str, Any]:
    """Return the comparable values of a flight, by name.

    ``uplink`` and ``downlink`` are the messages to and from one vehicle; names in ``skip`` (a
    message, or message.field) are omitted.
    """
    omitted = set(skip)
    found: dict[str, Any] = {}
    by_name: dict[str, list[Decoded]] = defaultdict(list)
    for one in downlink:
        by_name[one.name].append(one)
    for name, messages in by_name.items():
        found[f"{name}.is sent"] = True
        if name in {"PARAM_VALUE", "COMMAND_ACK", "STATUSTEXT", "TIMESYNC"} | omitted:
            continue
        for field in messages[0].fields:
            if f"{name}.{field}" not in omitted:
                found[f"{name}.{field}"] = _sequence(one.fields[field] for one in messages)
    found |= _answers(by_name["COMMAND_ACK"], uplink)
    found |= _order(downlink, uplink)
    found["STATUSTEXT"] = tuple(_texts(by_name["STATUSTEXT"]))
    found |= _rates(by_name, uplink)
    found |= _clock(by_name["TIMESYNC"], uplink)
    found |= _parameters(by_name["PARAM_VALUE"], uplink)
    return found


def _sequence(values: Iterable[Any]) -> Any:
    """Return the values in order without repetitions; "many" for more than a few."""
    rounded = [_rounded(value) for value in values]
    if len(set(rounded)) > _FEW:
        return "many"
    return tuple(value for value, _ in groupby(rounded))


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_rounded(one) for one in value)
    if isinstance(value, float):
        return "nan" if math.isnan(value) else float(f"{value:.3g}")
    return value


def _texts(downlink: Iterable[Decoded]) -> Iterator[tuple[int, str, bool]]:
    """Yield severity, text, and whether the text has an id."""
    for one in downlink:
        yield one.fields["severity"], one.fields["text"], bool(one.fields["id"])


def _commands(uplink: Iterable[Decoded]) -> Iterator[tuple[float, str]]:
    for one in uplink:
        if one.name == "COMMAND_LONG":
            p = [one.fields[f"param{k}"] for k in range(1, 4)]
            number = int(one.fields["command"])
            detail = int(p[0]) if number in {511, 512} else int(p[1]) if number == 176 else ""
            yield one.at, f"{number} {detail}".strip()


def _answers(acks: Sequence[Decoded], uplink: Sequence[Decoded]) -> dict[str, Any]:
    """Return the results of all acknowledgements, by command and its first parameter."""
    requested = list(_commands(uplink))
    found: dict[str, Any] = {}
    times = [at for at, _ in requested]
    answers: dict[int, list[int]] = defaultdict(list)
    for one in acks:
        candidates = [
            k for k in range(bisect_right(times, one.at + 1e-9))
            if requested[k][1].split()[0] == str(one.fields["command"])
        ]  # fmt: skip
        answers[candidates[-1] if candidates else -1].append(one.fields["result"])
    for k, (_, name) in enumerate(requested):
        found.setdefault(f"answer to {name}", []).append(tuple(answers[k]))
    return {name: tuple(results) for name, results in found.items()}


def _order(downlink: Sequence[Decoded], uplink: Sequence[Decoded]) -> dict[str, Any]:
    """Return the order of requested messages and acknowledgements, and of events."""
    requested = [at for at, name in _commands(uplink) if name == "512 148"]
    places = []
    for at in requested:
        names = [one.name for one in downlink if at <= one.at < at + 0.3]
        both = [name for name in names if name in {"COMMAND_ACK", "AUTOPILOT_VERSION"}]
        places.append(tuple(both))
    return {
        "order of AUTOPILOT_VERSION and its answer": tuple(places),
        "events": tuple(_events(downlink)),
    }


def _events(downlink: Sequence[Decoded]) -> Iterator[str]:
    """Yield the changes of modes, arming and landed states in order."""
    state: dict[str, Any] = {}
    for one in downlink:
        changes = {}
        if one.name == "HEARTBEAT":
            changes["armed"] = one.fields["base_mode"] >> 7
            changes["mode"] = one.fields["custom_mode"]
        elif one.name == "CURRENT_MODE":
            changes["mode"] = one.fields["custom_mode"]
        elif one.name == "EXTENDED_SYS_STATE":
            changes["landed"] = one.fields["landed_state"]
        for key, value in changes.items():
            known = key in state
            if state.get(key) != value:
                state[key] = value
                if known:
                    yield f"{key} {value}"


def _rates(by_name: Mapping[str, Sequence[Decoded]], uplink: Sequence[Decoded]) -> dict[str, Any]:
    """Return messages per second, before the requests, on the ground after them, in flight."""
    armed = next((at for at, name in _commands(uplink) if name == "400"), math.inf)
    requested = [at for at, name in _commands(uplink) if name.startswith("511 ") and at < armed]
    spans = {"initially": (0.05, 0.74), "on request": (max(requested) + 0.1, armed - 0.1),
             "in flight": (armed + 10.0, armed + 50.0)}  # fmt: skip
    found: dict[str, Any] = {}
    for name, messages in by_name.items():
        if name in {"COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE", "TIMESYNC", "EVENT"}:
            continue
        for span, (begin, end) in spans.items():
            n = sum(begin <= one.at < end for one in messages)
            found[f"rate of {name} {span}"] = _rate(n, end - begin)
    return found


def _rate(n: int, seconds: float) -> float:
    """Return the nearest requested rate, within the error of counting; 1 also stands for rates
    that are too slow to measure in a second."""
    rates = (0.0, 0.1, 0.33, 0.5, 1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 30.0, 50.0)
    if n <= 3 and seconds < 2.0:
        return 1.0
    return min(rates, key=lambda rate: abs(rate * seconds - n) - (0.5 if rate else 0.0))


def _clock(downlink: Sequence[Decoded], uplink: Sequence[Decoded]) -> dict[str, Any]:
    ours = {one.fields["ts1"] for one in uplink if one.name == "TIMESYNC"}
    replies = [one for one in downlink if one.fields["tc1"]]
    known = [one.fields["ts1"] in ours for one in replies]
    own = [one.at for one in downlink if not one.fields["tc1"]]
    every = (own[-1] - own[0]) / (len(own) - 1) if len(own) > 1 else math.inf
    return {
        "TIMESYNC replies to requests": round(sum(known) / len(ours), 1) if ours else 0.0,
        "TIMESYNC own requests, seconds apart": float(f"{every:.1g}"),
        "TIMESYNC unit": {len(str(one.fields["tc1"])) > 10 for one in replies},
    }


def _parameters(downlink: Sequence[Decoded], uplink: Sequence[Decoded]) -> dict[str, Any]:
    lists = [one.at for one in uplink if one.name == "PARAM_REQUEST_LIST"]
    if not lists:
        return {}
    listed = [one.fields for one in downlink if lists[-1] <= one.at < lists[-1] + 3.0]
    whole = [one["param_index"] for one in listed if one["param_index"] < 65535]
    count = listed[0]["param_count"] if listed else 0
    found = {
        "parameters: first of the list": _first(listed),
        "parameters: list is complete and in order": whole == list(range(count)),
        "parameters: sorted": _sorted(listed),
    }
    for one in listed:
        name = one["param_id"]
        found[f"parameter {name}: type"] = one["param_type"]
    return found


def _first(listed: Sequence[Mapping[str, Any]]) -> tuple[Any, ...]:
    if not listed or not listed[0]["param_id"].startswith("_"):
        return ()
    one = listed[0]
    return one["param_id"], one["param_type"], one["param_index"]


def _sorted(listed: Sequence[Mapping[str, Any]]) -> bool:
    names = [one["param_id"] for one in listed if one["param_index"] < 65535]
    return names == sorted(names)


def differences(
    real: Mapping[str, Any], other: Mapping[str, Any], known: Callable[[str], bool]
) -> dict[str, tuple[Any, Any]]:
    """Return the differing values (real, emulated) by name, without names that are ``known``."""
    found = {}
    sent, also = _messages(real), _messages(other)
    for name in sorted({*real, *other}):
        of = _message(name)
        if of in sent ^ also:
            name = f"message {of}"  # noqa: PLW2901 - one line for all its fields
            one, two = ("sent" if of in one else "-" for one in (sent, also))
        else:
            one, two = real.get(name, "-"), other.get(name, "-")
        if one != two and not known(name):
            found[name] = (one, two)
    return found


def _message(name: str) -> str:
    """Return the message of a fact; "" if the fact does not concern a message."""
    if name.startswith("rate of "):
        return name.split()[2]
    head, dot, _ = name.partition(".")
    return head if dot and head.isupper() else ""


def _messages(of: Iterable[str]) -> set[str]:
    return {_message(name) for name in of} - {""}


def table(found: Mapping[str, tuple[Any, Any]]) -> str:
    """Return differences as lines of a table."""
    rows = [
        f"{name:58} {_shortened(real)} | {_shortened(other)}"
        for name, (real, other) in found.items()
    ]
    return "\n".join([f"{'':58} real | emulated", *rows])


def _shortened(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 300 else text[:297] + "…"


def delays(downlink: Sequence[Decoded], uplink: Sequence[Decoded]) -> dict[str, float]:
    """Return the seconds from the last command or change to each first change of state."""
    last, name = 0.0, ""
    requested = [
        (at, name) for at, name in _commands(uplink) if name.split()[0] in {"400", "22", "176"}
    ]
    found: dict[str, float] = {}
    state: dict[str, int] = {}
    for one in downlink:
        while requested and requested[0][0] < one.at:
            last, name = requested.pop(0)
        if one.name == "HEARTBEAT":
            key, value = "armed", one.fields["base_mode"] >> 7
        elif one.name == "EXTENDED_SYS_STATE":
            key, value = "landed", one.fields["landed_state"]
        else:
            continue
        if state.setdefault(key, value) != value:
            change = f"{key} {value}"
            found.setdefault(f"{name} → {change}", one.at - last)
            last, name = one.at, change
        state[key] = value
    return found
