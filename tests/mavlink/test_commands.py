"""Commands as transcripts in virtual time: when they are sent, and their results."""

from collections import namedtuple
from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import common

from swarm.mavlink.commands import (
    ATTEMPTS,
    IN_PROGRESS_TIMEOUT,
    RESEND_AFTER,
    STATE_TIMEOUT,
    Command,
    CommandQueue,
)

ARM = common.MAV_CMD_COMPONENT_ARM_DISARM
Ack = namedtuple("Ack", "command result target_system target_component", defaults=(255, 190))

ACCEPTED = common.MAV_RESULT_ACCEPTED
REJECTED = common.MAV_RESULT_TEMPORARILY_REJECTED


@pytest.fixture
def queue():
    return CommandQueue(4, 1)


def run(queue, start, stop, step=0.1):
    """Tick from start to stop; return the sent [(time, confirmation)] and the results."""
    sent, results = [], []
    count = round((stop - start) / step)
    for k in range(count + 1):
        now = round(start + k * step, 6)
        messages, done = queue.tick(now)
        sent += [(now, message.confirmation) for message in messages]
        results += done
    return sent, results


def test_a_command_is_repeated_with_a_rising_confirmation_until_it_fails(queue):
    queue.add(Command("arm", ARM, [1, 0, 0, 0, 0, 0, 0]))
    sent, results = run(queue, 0.0, 10.0)
    assert [confirmation for _, confirmation in sent] == list(range(ATTEMPTS))
    gaps = [b[0] - a[0] for a, b in pairwise(sent)]
    assert gaps == pytest.approx([RESEND_AFTER] * (ATTEMPTS - 1))
    (result,) = results
    assert (result.succeeded, result.reason) == (False, "no acknowledgement")
    assert queue.idle


def test_a_message_has_the_vehicle_and_the_parameters(queue):
    queue.add(Command("takeoff", common.MAV_CMD_NAV_TAKEOFF, [0, 0, 0, 0, 0, 0, 2.5]))
    ((message,), _) = queue.tick(0.0)
    assert (message.target_system, message.target_component) == (4, 1)
    assert message.command == common.MAV_CMD_NAV_TAKEOFF
    assert message.param7 == 2.5


def test_an_acknowledgement_ends_a_command_without_a_resulting_state(queue):
    queue.add(Command("grab", 211, [1, 1, 0, 0, 0, 0, 0]))
    run(queue, 0.0, 0.2)
    queue.acknowledge(Ack(211, ACCEPTED), 0.25)
    sent, (result,) = run(queue, 0.3, 3.0)
    assert sent == []
    assert result.succeeded
    assert queue.latencies == [0.25]


def test_an_acknowledged_mode_counts_once_it_is_reported(queue):
    seen = []
    queue.add(Command("mode", 176, [1] * 7, reached=lambda: bool(seen)))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(176, ACCEPTED), 0.2)
    assert run(queue, 0.3, 1.0) == ([], [])
    seen.append(True)
    _, (result,) = run(queue, 1.1, 1.2)
    assert result.succeeded


def test_an_accepted_command_without_effect_fails(queue):
    queue.add(Command("mode", 176, [1] * 7, reached=lambda: False))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(176, ACCEPTED), 0.2)
    _, (result,) = run(queue, 0.3, STATE_TIMEOUT + 1.0)
    assert result.reason == "accepted, but the state was not reached"


def test_the_state_suffices_if_the_acknowledgement_is_lost(queue):
    armed = []
    queue.add(Command("arm", ARM, [1] * 7, reached=lambda: bool(armed)))
    run(queue, 0.0, 0.5)
    armed.append(True)
    _, (result,) = run(queue, 0.6, 0.7)
    assert result.succeeded


def test_each_in_progress_extends_the_timeout(queue):
    queue.add(Command("grab", 211, [0] * 7))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(211, common.MAV_RESULT_IN_PROGRESS), 0.2)
    sent, results = run(queue, 0.3, 0.1 + IN_PROGRESS_TIMEOUT)
    assert (sent, results) == ([], [])
    queue.acknowledge(Ack(211, ACCEPTED), 0.15 + IN_PROGRESS_TIMEOUT)
    assert run(queue, 0.2 + IN_PROGRESS_TIMEOUT, 0.3 + IN_PROGRESS_TIMEOUT)[1][0].succeeded


@pytest.mark.parametrize(
    ("result", "words"),
    [(REJECTED, "temporarily rejected"), (common.MAV_RESULT_FAILED, "failed")],
)
def test_a_temporary_rejection_is_retried_for_a_while(queue, result, words):
    queue.add(Command("arm", ARM, [1] * 7, reached=lambda: False, retry_for=2.0))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(ARM, result), 0.2)
    sent, _ = run(queue, 0.3, 1.3)
    assert [time for time, _ in sent] == [1.2]
    queue.acknowledge(Ack(ARM, result), 2.5)
    _, (result,) = run(queue, 2.6, 2.7)
    assert result.reason == words


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (common.MAV_RESULT_DENIED, "denied"),
        (common.MAV_RESULT_UNSUPPORTED, "unsupported"),
    ],
)
def test_a_permanent_rejection_is_final_and_has_a_reason(queue, result, words):
    queue.add(Command("arm", ARM, [1] * 7, reached=lambda: False, retry_for=5.0))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(ARM, result), 0.2)
    assert run(queue, 0.3, 0.3)[1][0].reason == words


def test_acknowledgements_for_other_stations_and_commands_are_ignored(queue):
    queue.add(Command("grab", 211, [0] * 7))
    run(queue, 0.0, 0.1)
    queue.acknowledge(Ack(211, ACCEPTED, 250, 190), 0.15)
    queue.acknowledge(Ack(211, ACCEPTED, 255, 1), 0.15)
    queue.acknowledge(Ack(400, ACCEPTED), 0.15)
    assert not queue.idle
    queue.acknowledge(Ack(211, ACCEPTED, 0, 0), 0.2)
    assert run(queue, 0.3, 0.3)[1][0].succeeded


def test_commands_with_one_number_are_sequential_others_parallel(queue):
    for number in (511, 511, 176):
        queue.add(Command(f"{number}", number, [0] * 7))
    messages, _ = queue.tick(0.0)
    assert [message.command for message in messages] == [511, 176]
    queue.acknowledge(Ack(511, ACCEPTED), 0.1)
    messages, _ = queue.tick(0.2)
    assert [message.command for message in messages] == [511]
