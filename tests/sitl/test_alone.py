"""What autopilots do alone after failures: the emulated ones as the recorded real ones.

`tests/recordings/failures.jsonl` has what PX4 1.16.0 and ArduCopter 4.6.2 did in our world, written
by `tests.recordings.alone`; the same failures are caused in emulated ones here.
"""

import json
import re
from pathlib import Path

import pytest

from tests.recordings.alone import fly

LINES = (Path(__file__).parents[1] / "recordings" / "failures.jsonl").read_text().splitlines()
RECORDED = {(one["kind"], one["row"]): one for one in map(json.loads, LINES)}
QUICK = ("battery", "receiver", "radio", "reboot")
OTHERS = ("weak thrust", "stream", "ground station", "disarm", "stranger", "other id")
SLACK = 2.5
"""Largest difference of times, seconds: heartbeats come once a second, PX4 checks the link to its
ground station every 1.25 s, failsafes are checked a few times a second."""
LEFT_OUT = re.compile("Preflight|PreArm|EKF3 IMU|SmartRTL|System does not support shutdown")
"""Texts that the emulator does not have: reasons against arming, details of the estimator, a
computer that cannot be turned off."""
WHEN = {("ardupilot", "battery")}
"""Failures that are not caused at the same times: the real one's voltage falls at once."""


def changes(seen, kind):
    """Return (time, value) of the changes of one kind ("mode", "ack", …)."""
    return [(at, what.split(" ", 1)[1]) for at, what in seen["changes"] if what.startswith(kind)]


def texts(seen):
    """Return the set of texts, without numbers."""
    found = {text for _, text in changes(seen, "text") if not LEFT_OUT.match(text)}
    return {re.sub(r"[\d.]+", "#", text) for text in found}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "row"),
    [
        pytest.param(kind, row, marks=() if row in QUICK else pytest.mark.full)
        for kind in ("px4", "ardupilot")
        for row in (*QUICK, *OTHERS)
    ],
)
def test_the_emulated_autopilot_does_what_the_real_one_did(kind, row):
    real, emulated = RECORDED[kind, row], fly(kind, row, None)
    assert real["flying"]
    assert emulated["flying"]
    assert texts(emulated) == texts(real)
    for what in ("mode", "armed", "ack"):
        one, two = changes(real, what), changes(emulated, what)
        assert [value for _, value in one] == [value for _, value in two], what
        if (kind, row) not in WHEN and row != "receiver":
            assert all(abs(a - b) < SLACK for (a, _), (b, _) in zip(one, two, strict=True)), what


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_real_ones_land_within_seconds_of_each_other_without_a_receiver(kind):
    (first, mode), *_ = changes(RECORDED[kind, "receiver"], "mode")
    assert mode == "land"
    assert first == pytest.approx(6.0 if kind == "px4" else 8.0, abs=0.1)
