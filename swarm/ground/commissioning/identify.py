"""Which body of motion capture is on which vehicle, ``swarm mocap --identify``: on the ground.

The identification is in :mod:`swarm.flight.identification`. Here it gets what arrives, in a thread
beside the loop. Nothing is armed.
"""

import json
import math
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common

from swarm.errors import InputError, Problem, Refused, VehicleError, reason
from swarm.exports import finding_object
from swarm.flight.identification import Identification
from swarm.ground.commissioning.survey import Survey, open_survey
from swarm.ground.mocap import MocapBridge
from swarm.ground.mocap_bridge import Borrowed
from swarm.mavlink.telemetry_table import Vector
from swarm.mission.fleet import Fleet

RATE = 20.0
"""Attitudes and comparisons per second: hands need half a second for a motion."""
_ASK_AGAIN = 10.0
"""Seconds between requests for attitudes, of which one may be lost."""
_OLD = 1.0
"""Seconds after which a vehicle's attitude says nothing of the present: twenty at RATE."""


def identify(
    fleet: Fleet,
    folder: Path,
    source: str | None,
    say: Callable[[str], None],
    show: Callable[[str], None],
) -> Identification:
    """Ask for one vehicle after the other, and return what moved with each.

    ``source`` is the URL of the motion capture system; None: that of the bridge that runs for the
    fleet. ``say`` gets what is asked for and what was found, ``show`` what remains to be done. The
    result is written to bodies.json in ``folder``.

    Raises :class:`Refused` for armed vehicles and where no poses come, and :class:`VehicleError`
    for missing vehicles.
    """
    with open_survey(fleet, folder, mocap=source) as survey:

        def work() -> Identification:
            _poses(survey)
            listener = survey.listener
            missing = survey.wait_for_vehicles(
                lambda: show(f"received {len(listener.received)} of {len(listener.fleet.vehicles)}")
            )
            if missing:
                raise VehicleError(f"not received: {', '.join(f'system {s}' for s in missing)}")
            survey.relay.closed = True
            return guided(survey, folder, say, lambda _, words: show(words))

        return survey.run(work)


def identification_object(identification: Identification) -> dict[str, Any]:
    """Return which body each vehicle moves, and the findings."""
    findings = identification.findings()
    return {
        "passed": identification.done and all(f.severity != "error" for f in findings),
        "vehicles": [
            {"system": result.system, "body": result.body}
            for result in identification.results.values()
        ],
        "findings": [finding_object(finding) for finding in findings],
    }


def _poses(survey: Survey) -> Borrowed | MocapBridge:
    if survey.poses is None:
        raise Refused("no bridge of motion capture runs for this fleet: give a SOURCE")
    return survey.poses


def guided(
    survey: Survey,
    folder: Path,
    say: Callable[[str], None],
    show: Callable[[Identification, str], None],
) -> Identification:
    """Ask for one vehicle after the other; all are received. Blocks, so it runs in a thread.

    ``show`` gets what is known so far, and what remains to be done, twenty times a second.
    """
    listener, poses = survey.listener, _poses(survey)
    identification = Identification(listener.fleet.systems)
    asked_again = 0.0
    while not identification.done:
        now = listener.now
        armed = [vehicle.system for vehicle in listener.received if vehicle.armed]
        if armed:
            raise Refused(f"system {', '.join(map(str, armed))} is armed: nothing is lifted")
        if now >= asked_again:
            asked_again = now + _ASK_AGAIN
            for vehicle in listener.received:
                vehicle.request_interval(common.MAVLINK_MSG_ID_ATTITUDE, RATE)
        attitudes = {
            vehicle.system: vehicle.attitude
            for vehicle in listener.received
            if now - vehicle.received_at <= _OLD and math.isfinite(vehicle.attitude[0])
        }
        for words in identification.step(now, attitudes, poses.bodies(now)):
            say(words)
        show(identification, _remaining(identification, attitudes))
        survey.wait(1.0 / RATE)
    path = folder / "bodies.json"
    try:
        result = {
            "fleet": listener.fleet.name,
            "date": f"{datetime.now().astimezone():%F %T%z}",
        }
        result |= identification_object(identification)
        path.write_text(json.dumps(result, indent=1))
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
    return identification


def moved_words(identification: Identification) -> dict[int, str]:
    """Return what was seen of each vehicle, and which one is to be moved now, by system id."""
    words = {
        system: "moves its body"
        if result.own
        else f"moves body {result.body}"
        if result.body is not None and result.body != system
        else "its body is wrong"
        for system, result in identification.results.items()
    }
    if identification.asked is not None:
        words[identification.asked] = "move this one now"
    return dict.fromkeys(identification.systems, "leave it on the ground") | words


def _remaining(identification: Identification, attitudes: Mapping[int, Vector]) -> str:
    """Return what the person is waited for."""
    if identification.asked is not None:
        return f"vehicle {identification.asked}: {', '.join(identification.remaining)}"
    unheard = [s for s in identification.systems if s not in attitudes]
    if unheard:
        return f"no attitude of vehicle {', '.join(map(str, unheard))}"
    return "waiting until all vehicles stand still"
