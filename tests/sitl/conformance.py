"""What a vehicle said, field by field, in a form in which two vehicles can be compared.

A recording of a real autopilot has both directions. `emulated` tells an emulated vehicle the same
things at the same times; `facts` reduces what either of them said to named values, and
`differences` lists those that differ.
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
"""Up to so many distinct values are compared one by one; more are "many"."""
_NEWER = {8: "LINK_NODE_STATUS", 380: "TIME_ESTIMATE_TO_TARGET", 397: "COMPONENT_METADATA",
          410: "EVENT", 411: "CURRENT_EVENT_SEQUENCE"}  # fmt: skip
"""Messages that are newer than the library that decodes the others."""
dialect.mavlink_map.setdefault(436, development.mavlink_map[436])


@dataclass(frozen=True)
class Said:
    """A message that a vehicle sent: when, its name, its fields."""

    at: float
    name: str
    fields: Mapping[str, Any]


def emulated(
    emulator: Emulator, told: Packets, system: int, delay: float, end: float
) -> list[tuple[float, bytes]]:
    """Tell an emulated vehicle what a real one was told, ``delay`` seconds later.

    Returns what it said, with times as in the recording; ``end`` is when it ends.
    """
    said: list[tuple[float, bytes]] = []
    queue = iter([*told, (math.inf, b"")])
    at, packet = next(queue)
    for k in range(1, math.ceil((end + delay) / _STEP) + 1):
        now = k * _STEP
        while at + delay <= now:
            emulator.receive(system, packet, now)
            at, packet = next(queue)
        for who, data in emulator.step(now):
            if who == system:
                said += [(now - delay, one) for one in _split(data) if now >= delay]
    return said


def _split(data: bytes) -> Iterator[bytes]:
    while data:
        length = 12 + data[1]
        yield data[:length]
        data = data[length:]


def to_vehicle(packets: Iterable[tuple[float, bytes]], system: int) -> list[tuple[float, bytes]]:
    """Return the ground station's packets that a vehicle gets."""
    return [
        (at, packet)
        for at, packet in packets
        if packet[5] == GROUND and packet[6] == 190 and addressed(packet) in {0, system}
    ]


def decoded(packets: Iterable[tuple[float, bytes]]) -> list[Said]:
    """Return packets with their fields by name; of the newest messages the name alone."""
    reader = dialect.MAVLink(None)
    said = []
    for at, packet in packets:
        name = _NEWER.get(number(packet))
        if name is None:
            message = reader.decode(bytearray(packet))
            fields = message.to_dict()
            name = fields.pop("mavpackettype")
        else:
            fields = {}
        said.append(Said(at, name, fields))
    return said


def facts(said: Sequence[Said], told: Sequence[Said], skip: Iterable[str] = ()) -> dict[str, Any]:
    """Return what can be compared of a flight, by name.

    Told and said are of one vehicle; names in ``skip`` (a message, or message.field) are left out.
    """
    left_out = set(skip)
    found: dict[str, Any] = {}
    by_name: dict[str, list[Said]] = defaultdict(list)
    for one in said:
        by_name[one.name].append(one)
    for name, all_of_it in by_name.items():
        found[f"{name}.is sent"] = True
        if name in {"PARAM_VALUE", "COMMAND_ACK", "STATUSTEXT", "TIMESYNC"} | left_out:
            continue
        for field in all_of_it[0].fields:
            if f"{name}.{field}" not in left_out:
                found[f"{name}.{field}"] = _course(one.fields[field] for one in all_of_it)
    found |= _answers(by_name["COMMAND_ACK"], told)
    found |= _order(said, told)
    found["STATUSTEXT"] = tuple(_texts(by_name["STATUSTEXT"]))
    found |= _rates(by_name, told)
    found |= _clock(by_name["TIMESYNC"], told)
    found |= _parameters(by_name["PARAM_VALUE"], told)
    return found


def _course(values: Iterable[Any]) -> Any:
    """Values one after the other without repetitions; "many" where they are."""
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


def _texts(said: Iterable[Said]) -> Iterator[tuple[int, str, bool]]:
    """Severity, wording, and whether a text has a number of its own."""
    for one in said:
        yield one.fields["severity"], one.fields["text"], bool(one.fields["id"])


def _commands(told: Iterable[Said]) -> Iterator[tuple[float, str]]:
    for one in told:
        if one.name == "COMMAND_LONG":
            p = [one.fields[f"param{k}"] for k in range(1, 4)]
            number = int(one.fields["command"])
            detail = int(p[0]) if number in {511, 512} else int(p[1]) if number == 176 else ""
            yield one.at, f"{number} {detail}".strip()


def _answers(acks: Sequence[Said], told: Sequence[Said]) -> dict[str, Any]:
    """Results and number of acknowledgements, by command and what it is about."""
    asked = list(_commands(told))
    found: dict[str, Any] = {}
    times = [at for at, _ in asked]
    answers: dict[int, list[int]] = defaultdict(list)
    for one in acks:
        candidates = [
            k for k in range(bisect_right(times, one.at + 1e-9))
            if asked[k][1].split()[0] == str(one.fields["command"])
        ]  # fmt: skip
        answers[candidates[-1] if candidates else -1].append(one.fields["result"])
    for k, (_, name) in enumerate(asked):
        found.setdefault(f"answer to {name}", []).append(tuple(answers[k]))
    return {name: tuple(results) for name, results in found.items()}


def _order(said: Sequence[Said], told: Sequence[Said]) -> dict[str, Any]:
    """Whether a message that was asked for comes before its acknowledgement; order of events."""
    asked = [at for at, name in _commands(told) if name == "512 148"]
    places = []
    for at in asked:
        names = [one.name for one in said if at <= one.at < at + 0.3]
        both = [name for name in names if name in {"COMMAND_ACK", "AUTOPILOT_VERSION"}]
        places.append(tuple(both))
    return {
        "order of AUTOPILOT_VERSION and its answer": tuple(places),
        "events": tuple(_events(said)),
    }


def _events(said: Sequence[Said]) -> Iterator[str]:
    """What changed, in order: modes, arming, landed states."""
    state: dict[str, Any] = {}
    for one in said:
        news = {}
        if one.name == "HEARTBEAT":
            news["armed"] = one.fields["base_mode"] >> 7
            news["mode"] = one.fields["custom_mode"]
        elif one.name == "CURRENT_MODE":
            news["mode"] = one.fields["custom_mode"]
        elif one.name == "EXTENDED_SYS_STATE":
            news["landed"] = one.fields["landed_state"]
        for key, value in news.items():
            known = key in state
            if state.get(key) != value:
                state[key] = value
                if known:
                    yield f"{key} {value}"


def _rates(by_name: Mapping[str, Sequence[Said]], told: Sequence[Said]) -> dict[str, Any]:
    """Messages a second, before requests are over, on the ground after that, and in flight."""
    armed = next((at for at, name in _commands(told) if name == "400"), math.inf)
    asked = [at for at, name in _commands(told) if name.startswith("511 ") and at < armed]
    spans = {"at first": (0.05, 0.74), "when asked": (max(asked) + 0.1, armed - 0.1),
             "in flight": (armed + 10.0, armed + 50.0)}  # fmt: skip
    found: dict[str, Any] = {}
    for name, all_of_it in by_name.items():
        if name in {"COMMAND_ACK", "STATUSTEXT", "PARAM_VALUE", "TIMESYNC", "EVENT"}:
            continue
        for span, (begin, end) in spans.items():
            n = sum(begin <= one.at < end for one in all_of_it)
            found[f"rate of {name} {span}"] = _rate(n, end - begin)
    return found


def _rate(n: int, seconds: float) -> float:
    """A rate among those that are asked for, within the error of counting; 1 is all that is too
    slow to be measured in a second."""
    known = (0.0, 0.1, 0.33, 0.5, 1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 30.0, 50.0)
    if n <= 3 and seconds < 2.0:
        return 1.0
    return min(known, key=lambda rate: abs(rate * seconds - n) - (0.5 if rate else 0.0))


def _clock(said: Sequence[Said], told: Sequence[Said]) -> dict[str, Any]:
    ours = {one.fields["ts1"] for one in told if one.name == "TIMESYNC"}
    replies = [one for one in said if one.fields["tc1"]]
    known = [one.fields["ts1"] in ours for one in replies]
    own = [one.at for one in said if not one.fields["tc1"]]
    every = (own[-1] - own[0]) / (len(own) - 1) if len(own) > 1 else math.inf
    return {
        "TIMESYNC replies to requests": round(sum(known) / len(ours), 1) if ours else 0.0,
        "TIMESYNC own requests, seconds apart": float(f"{every:.1g}"),
        "TIMESYNC unit": {len(str(one.fields["tc1"])) > 10 for one in replies},
    }


def _parameters(said: Sequence[Said], told: Sequence[Said]) -> dict[str, Any]:
    lists = [one.at for one in told if one.name == "PARAM_REQUEST_LIST"]
    if not lists:
        return {}
    listed = [one.fields for one in said if lists[-1] <= one.at < lists[-1] + 3.0]
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
    """Return by name what differs, as (real, emulated); ``known`` tells which names to leave out."""
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
    """The message that a fact is about; "" where it is about something else."""
    if name.startswith("rate of "):
        return name.split()[2]
    head, dot, _ = name.partition(".")
    return head if dot and head.isupper() else ""


def _messages(of: Iterable[str]) -> set[str]:
    return {_message(name) for name in of} - {""}


def table(found: Mapping[str, tuple[Any, Any]]) -> str:
    """Return differences as lines of a table."""
    rows = [f"{name:58} {_brief(real)} | {_brief(other)}" for name, (real, other) in found.items()]
    return "\n".join([f"{'':58} real | emulated", *rows])


def _brief(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 300 else text[:297] + "…"


def delays(said: Sequence[Said], told: Sequence[Said]) -> dict[str, float]:
    """Seconds from the command or change before it to each first change of arming and landing."""
    last, name = 0.0, ""
    asked = [(at, name) for at, name in _commands(told) if name.split()[0] in {"400", "22", "176"}]
    found: dict[str, float] = {}
    state: dict[str, int] = {}
    for one in said:
        while asked and asked[0][0] < one.at:
            last, name = asked.pop(0)
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
