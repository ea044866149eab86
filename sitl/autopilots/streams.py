"""Telemetry: sending of one message, and of the streams that are due."""

from collections.abc import Iterable, Mapping
from heapq import heappop, heapreplace

from sitl.autopilots import telemetry
from sitl.protocol import wire
from sitl.protocol.links import Link
from sitl.protocol.vehicle import Vehicle

_MESSAGES = {
    name: (build, wire.LAYOUTS[name].number, wire.LAYOUTS[name].seed)
    for name, build in telemetry.MESSAGES.items()
}


def send_message(v: Vehicle, name: str, link: Link) -> bool:
    """Send one telemetry message now; return False if the vehicle has no such data."""
    build, number, seed = _MESSAGES[name]
    body = build(v)
    if body is None:
        return False
    sender, ticks = link.sender, 0
    if sender.signer:
        ticks = v.signing_ticks()
    link.outgoing.append(sender.frame(number, body, seed, ticks))
    return True


def send_now(v: Vehicle, *names: str) -> None:
    """Send telemetry messages now on all links, in addition to their streams."""
    for link in v.links:
        for name in names:
            send_message(v, name, link)


def default_streams(v: Vehicle, link: Link) -> Mapping[str, float]:
    """Return the rates (Hz) of the messages that the autopilot sends on this kind of link."""
    return v.autopilot.streams[link.kind]


def send_due(links: Iterable[tuple[Vehicle, Link]], now: float) -> None:
    """Send the messages that are due on these links, and set their next times.

    A simulated flight spends a sixth of its time here.
    """
    limit, messages = now + 1e-6, _MESSAGES
    for v, link in links:
        due = link.due
        if not due or due[0][0] > limit:
            continue
        v.now = max(v.now, now)
        intervals, outgoing, sender = link.intervals, link.outgoing, link.sender
        frame, ticks = sender.frame, 0
        if sender.signer:
            ticks = v.signing_ticks()
        while due:
            time, name = due[0]
            if time > limit:
                break
            interval = intervals.get(name)
            if interval is None:
                heappop(due)
                continue
            following = time + interval
            heapreplace(due, (following if following > now - interval else now, name))
            build, number, seed = messages[name]
            body = build(v)
            if body is not None:
                outgoing.append(frame(number, body, seed, ticks))
