"""Transcripts of the console's session: who has command, and what becomes of each message."""

import json

import pytest

from swarm.console.session import (
    ABSENT_TIME,
    ANSWER_TIME,
    JOIN_CODE,
    JOIN_TIME,
    KEPT_TIME,
    LARGEST_MESSAGE,
    MANY_TOKENS_CODE,
    MESSAGE_CODE,
    RATE_CODE,
    REPLACED_CODE,
    TOKEN_CODE,
    Close,
    Send,
    Session,
    Tell,
)

TOKEN = "abcd-efgh-jkmn-pqrs"  # noqa: S105 - of this test
NUMBER = "to stop all motors in the air, type: kill 4821"


class Console:
    """A session, and a transcript of what it puts out: messages by connection, closes, lines."""

    def __init__(self):
        keys = iter(range(1000))
        self.session = Session(TOKEN, lambda: f"key {next(keys)}")
        self.session.closed = ""
        self.now = 0.0
        self.sent, self.closed, self.told = [], {}, []

    def take(self, outputs):
        new = []
        for output in outputs:
            if isinstance(output, Send):
                self.sent.append((output.connection, output.message))
                new.append((output.connection, output.message))
            elif isinstance(output, Close):
                self.closed[output.connection] = (output.code, output.reason)
            else:
                assert isinstance(output, Tell)
                self.told.append(output.line)
        return new

    def connect(self, connection, address="10.0.0.1"):
        return self.take(self.session.connect(connection, address, self.now))

    def say(self, connection, do, **content):
        text = json.dumps({"do": do, **content})
        return self.take(self.session.receive(connection, text, self.now))

    def join(self, connection, name="", key="", token=TOKEN, address="10.0.0.1"):
        self.connect(connection, address)
        return self.say(connection, "join", token=token, key=key, name=name)

    def lose(self, connection):
        return self.take(self.session.disconnect(connection, self.now))

    def answer(self, words):
        return self.take(self.session.answer(words))

    def wait(self, seconds):
        self.now += seconds
        return self.take(self.session.tick(self.now))

    def key(self, connection):
        return next(m["key"] for c, m in self.sent if c == connection and m["kind"] == "joined")

    def people(self, connection):
        return [m for c, m in self.sent if c == connection and m["kind"] == "people"][-1]

    def lines(self):
        """The lines that the flight got since the last call."""
        told, self.told = self.told, []
        return told


@pytest.fixture
def console():
    return Console()


@pytest.fixture
def two(console):
    """Anna has command, Ben reads."""
    console.join(1, "Anna")
    console.join(2, "Ben")
    console.say(1, "take")
    console.lines()
    return console


def answers(messages):
    return [(c, m["command"], m["words"]) for c, m in messages if m["kind"] == "answer"]


def test_a_person_joins_takes_command_and_holds(console):
    console.join(1, "Anna")
    assert console.lines() == ["screens 1"]
    assert console.people(1)["holder"] is None
    console.say(1, "take")
    assert console.people(1)["holder"] == 1
    assert console.lines() == ["note Anna (console 1) takes command"]
    console.say(1, "command", command="hold")
    assert console.lines() == ["name Anna (console 1)", "hold"]
    assert answers(console.answer("all stop along the path")) == [
        (1, "hold", "all stop along the path")
    ]


def test_who_has_no_command_only_reads(two):
    for do, content in (
        ("command", {"command": "land"}),
        ("kill", {}),
        ("cancel kill", {}),
        ("hand over", {}),
        ("leave", {}),
    ):
        (answer,) = answers(two.say(2, do, **content))
        assert answer == (2, do, "Anna (console 1) has command: this console only reads")
    assert two.lines() == []


def test_a_go_has_the_time_of_the_state_that_its_page_shows(two):
    two.say(1, "command", command="go", seen=12.5)
    assert two.lines() == ["name Anna (console 1)", "go 12.5"]
    assert answers(two.answer("arms 3 vehicles")) == [(1, "go", "arms 3 vehicles")]
    said = two.say(2, "command", command="go", seen=12.5)
    assert answers(said) == [
        (2, "command", "Anna (console 1) has command: this console only reads")
    ]
    assert two.lines() == []


@pytest.mark.parametrize("seen", [{}, {"seen": "12.5"}, {"seen": None}, {"seen": True}])
def test_a_go_without_the_time_that_was_seen_ends_its_connection(two, seen):
    two.say(1, "command", command="go", **seen)
    assert two.closed[1] == (MESSAGE_CODE, "seen: expected a time")
    assert not any(line.startswith("go") for line in two.lines())


def test_command_is_handed_over_on_request(two):
    two.say(2, "take")
    for connection in (1, 2):
        assert two.people(connection)["asking"] == 2
        assert two.people(connection)["left"] == ANSWER_TIME
    two.say(1, "command", command="hold")  # who has command keeps it until it is handed over
    assert two.lines() == ["name Anna (console 1)", "hold"]
    two.say(1, "hand over")
    assert two.people(1)["holder"] == 2
    assert two.lines() == ["note Ben (console 2) takes command from Anna (console 1)"]
    two.say(2, "command", command="land")
    assert two.lines() == ["name Ben (console 2)", "land"]


def test_command_is_kept_and_asked_for_again(two):
    two.say(2, "take")
    assert answers(two.say(1, "keep")) == [(2, "take", "Anna (console 1) keeps command")]
    assert two.people(2)["asking"] is None
    assert answers(two.say(1, "keep")) == [(1, "keep", "no one asks for command now")]
    two.say(2, "take")
    assert two.people(1)["asking"] == 2
    two.join(3, "Cleo")
    (answer,) = answers(two.say(3, "take"))
    assert answer == (3, "take", "Ben (console 2) has asked before")
    two.lose(2)
    assert two.people(1)["asking"] is None


def test_command_passes_when_nobody_answers(two):
    two.say(2, "take")
    two.wait(ANSWER_TIME - 0.1)
    assert two.people(2)["holder"] == 1
    two.wait(0.2)
    assert two.people(2)["holder"] == 2
    assert two.lines() == [
        "note Ben (console 2) takes command from Anna (console 1) (Anna (console 1) did not answer)"
    ]


def test_a_page_that_is_loaded_again_keeps_command(two):
    two.lose(1)
    assert two.people(2)["holder"] == 1
    assert [one["here"] for one in two.people(2)["people"]] == [False, True]
    two.wait(3.0)
    two.join(3, key=two.key(1))
    assert two.people(3)["holder"] == 1
    two.say(3, "command", command="resume")
    assert two.lines() == [
        "note Anna (console 1) has command and lost the connection",
        "name Anna (console 1)",
        "resume",
    ]


def test_command_of_a_lost_connection_can_be_taken_at_once(two):
    two.lose(1)
    two.say(2, "take")
    assert two.people(2)["holder"] == 2
    two.join(3, key=two.key(1))
    assert two.people(3)["holder"] == 2
    (answer,) = answers(two.say(3, "command", command="resume"))
    assert answer[2] == "Ben (console 2) has command: this console only reads"


def test_command_of_a_person_who_does_not_come_back_is_free(two):
    two.lose(1)
    two.wait(KEPT_TIME + 0.1)
    assert two.people(2)["holder"] is None
    assert [one["number"] for one in two.people(2)["people"]] == [2]
    two.join(3, key=two.key(1))
    assert two.people(3)["holder"] is None


def test_the_same_person_in_another_window_ends_the_first(two):
    two.join(3, key=two.key(1))
    assert two.closed[1][0] == REPLACED_CODE
    assert two.people(3)["holder"] == 1
    assert two.take(two.session.receive(1, '{"do": "take"}', two.now)) == []


def test_a_page_that_is_loaded_again_is_no_screen_that_is_gone(console):
    console.join(1)
    assert console.lines() == ["screens 1"]
    console.lose(1)
    console.wait(ABSENT_TIME - 1.0)
    assert console.lines() == []
    console.join(2, key=console.key(1))
    assert console.lines() == []
    console.lose(2)
    console.wait(ABSENT_TIME + 0.1)
    assert console.lines() == ["screens 0"]


def test_kill_is_confirmed_by_typing_the_number(two):
    two.say(1, "kill")
    assert two.lines() == ["name Anna (console 1)", "kill"]
    ((connection, message),) = two.answer(NUMBER)
    assert (connection, message["number"], message["again"]) == (1, "4821", False)
    two.say(1, "kill", number="1111")
    assert two.lines() == ["name Anna (console 1)", "kill 1111"]
    ((_, message),) = two.answer(NUMBER.replace("4821", "7777"))
    assert (message["number"], message["again"]) == ("7777", True)
    two.say(1, "kill", number="7777")
    assert two.lines() == ["name Anna (console 1)", "kill 7777"]
    assert answers(two.answer("stops all motors at once"))[0][1] == "kill"


def test_kill_is_cancelled_with_an_answer(two):
    two.say(1, "kill")
    two.answer(NUMBER)
    two.lines()
    two.say(1, "cancel kill")
    assert two.lines() == ["name Anna (console 1)", "kill cancel"]
    assert answers(two.answer("kill: cancelled; nothing was stopped")) == [
        (1, "kill", "kill: cancelled; nothing was stopped")
    ]
    assert two.say(1, "cancel kill") == []
    assert two.lines() == []


@pytest.mark.parametrize("end", ["handed over", "lost"])
def test_the_number_for_kill_ends_with_command(two, end):
    two.say(1, "kill")
    two.answer(NUMBER)
    two.say(2, "take")
    two.lines()
    if end == "lost":
        two.lose(1)
    else:
        two.say(1, "hand over")
    assert "kill cancel" in two.lines()
    two.answer("kill: cancelled; nothing was stopped")
    two.say(2, "take")
    two.lines()
    two.say(2, "kill", number="4821")  # the flight knows no such number any more
    assert two.lines() == ["name Ben (console 2)", "kill 4821"]


def test_a_number_that_comes_after_command_has_passed_is_shown_to_nobody(two):
    two.say(1, "kill")
    two.say(2, "take")
    two.say(1, "hand over")
    assert two.answer(NUMBER) == []


def test_before_and_after_the_flight_no_request_is_passed_on(two):
    for why in ("the flight has not begun yet", "the flight has ended"):
        two.session.closed = why
        assert answers(two.say(1, "command", command="hold")) == [(1, "hold", why)]
        assert answers(two.say(1, "kill")) == [(1, "kill", why)]
    assert two.lines() == []


def test_a_thousand_wrong_tokens(console):
    """From one address: a few are compared, the others refused; the right one gets in afterwards."""
    console.join(1, "Anna", address="10.0.0.2")
    compared = refused = 0
    for k in range(1000):
        console.now += 0.01
        console.join(100 + k, token=f"wrong {k}")
        code, _ = console.closed[100 + k]
        compared += code == TOKEN_CODE
        refused += code == MANY_TOKENS_CODE
    assert compared + refused == 1000
    assert compared <= 5 + 11  # five at once, then one a second
    assert console.session.joined == (1,)
    assert [line for line in console.lines() if "wrong" in line] == [
        "note wrong tokens for the console from 10.0.0.1"
    ]
    console.join(2000)
    assert console.closed[2000][0] == MANY_TOKENS_CODE  # the right one, while none is compared
    console.join(2001, address="10.0.0.2")
    assert 2001 in console.session.joined  # another address is not stopped
    console.wait(1.1)
    console.join(2002)
    assert 2002 in console.session.joined


def test_wrong_tokens_from_any_number_of_addresses_need_no_memory(console):
    for k in range(2000):
        console.join(k, token=f"wrong {k}", address=f"10.0.{k // 256}.{k % 256}")
    assert len(console.session._wrong) == 256
    assert console.session.joined == ()


@pytest.mark.parametrize("token", ["ABCDEFGHJKMNPQRS", "abcd efgh jkmn pqrs", f" {TOKEN} "])
def test_a_token_is_the_same_as_people_type_it(console, token):
    console.join(1, token=token)
    assert console.session.joined == (1,)


@pytest.mark.parametrize("token", ["", "abcd-efgh-jkmn-pqr", TOKEN + "s", "\ud800", "é" * 16])
def test_another_token_is_refused(console, token):
    console.join(1, token=token)
    assert console.closed[1][0] == TOKEN_CODE


def test_without_a_token_a_connection_ends(console):
    console.connect(1)
    console.wait(JOIN_TIME - 0.1)
    assert console.closed == {}
    console.wait(0.2)
    assert console.closed[1] == (JOIN_CODE, "no token")


GARBAGE = [
    "", "hold", "null", "[]", '{"do"', '{"do": 1}', '{"do": "nothing"}', "9" * 5000,
    '{"do": "command", "command": "kill"}', '{"do": "command", "command": "return to launch"}',
    '{"do": "kill", "number": "1\\nland"}', '{"do": "kill", "number": 4821}',
    '{"do": "name", "name": {}}', "[" * 900, "x" * (LARGEST_MESSAGE + 1), b"\x00\xff", b"{}",
    json.dumps({"do": "name", "name": "x" * LARGEST_MESSAGE}),
]  # fmt: skip


@pytest.mark.parametrize("garbage", GARBAGE)
def test_garbage_ends_its_connection_and_no_other(two, garbage):
    two.take(two.session.receive(1, garbage, two.now))
    assert two.closed[1][0] == MESSAGE_CODE
    assert 2 not in two.closed
    assert all(line.startswith("note") for line in two.lines())
    assert two.people(2)["holder"] == 1  # as for a lost connection: she may come back
    before = Console()
    before.connect(1)
    before.take(before.session.receive(1, garbage, 0.0))
    assert before.closed[1][0] == MESSAGE_CODE


def test_a_flood_of_messages_ends_its_connection(two):
    for _ in range(100):
        two.say(2, "take")
    assert two.closed[2][0] == RATE_CODE
    two.now += 10.0
    for _ in range(100):
        two.now += 0.2
        two.say(1, "command", command="hold")
    assert 1 not in two.closed


def test_more_browsers_than_may_look_are_refused(console):
    for k in range(200):
        console.connect(k)
    assert len(console.closed) == 200 - 64
    assert all(reason == "too many browsers" for _, reason in console.closed.values())


def test_names_are_one_line_of_the_control_socket(console):
    console.join(1, "  Anna\nland\x1b[2J \U0001f681" + "\U0001f681" * 30)
    console.join(2, "B" * 90)
    console.say(1, "take")
    console.say(2, "take")
    console.wait(ANSWER_TIME + 1.0)
    for line in console.lines():
        assert "\n" not in line
        assert len(line.encode()) < 400
    assert console.people(2)["people"][1]["words"] == f"{'B' * 24} (console 2)"


def test_people_who_left_are_forgotten(console):
    for k in range(500):
        console.join(k)
        console.lose(k)
    assert len(console.session._people) <= 64
    console.wait(KEPT_TIME + 1.0)
    assert console.session._people == {}
