"""A flight live for Foxglove: a client and readers that share no code with its library."""

import json
import socket
import struct
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from swarm.console.launch import DEFAULT, parse_address
from swarm.view import feeds
from swarm.view.feeds import start
from swarm.view.viewers import free_port
from tests.reports.synthetic import events, fly, snapshot_at, trefoil_plan

PATIENCE = 60.0
PLAN = trefoil_plan()
FIGURES = {"/mission", "/margins", *(f"/vehicle_{k + 1}/state" for k in range(PLAN.vehicles))}
TOPICS = {"/scene", "/tf", "/events"} | FIGURES


@pytest.fixture(autouse=True)
def own_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Prefer a port that flights of tests beside these do not."""
    monkeypatch.setattr("swarm.view.feeds.FOXGLOVE_PORT", free_port())


class Client:
    """Subscribes to all channels of a server (foxglove.sdk.v1), and keeps what arrives."""

    def __init__(self, stack: ExitStack, url: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                connection = connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None)
                break
            except ConnectionRefusedError:
                assert time.monotonic() < deadline
        self._connection = stack.enter_context(connection)
        self.topics: dict[int, str] = {}
        self.messages: list[tuple[str, bytes]] = []

    def read(self, seconds: float) -> bool:
        """Read one message, if any; False at the end of the connection."""
        try:
            message = self._connection.recv(timeout=seconds)
        except TimeoutError:
            return True
        except ConnectionClosed:
            return False
        if isinstance(message, bytes):
            number, _ = struct.unpack_from("<IQ", message, 1)
            self.messages.append((self.topics[number], message[13:]))
        elif (said := json.loads(message))["op"] == "advertise":
            new = {channel["id"]: channel["topic"] for channel in said["channels"]}
            self.topics |= new
            wanted = [{"id": number, "channelId": number} for number in new]
            self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        return True

    def until_topics(self, topics: set[str], offer) -> None:
        """Read until all topics have messages; more is offered when all that came is read."""
        deadline = time.monotonic() + PATIENCE
        while not topics <= {topic for topic, _ in self.messages}:
            assert time.monotonic() < deadline, topics - {topic for topic, _ in self.messages}
            offer()
            before = -1
            while len(self.messages) != before:
                before = len(self.messages)
                assert self.read(0.1)


def decoded(path: Path) -> dict[str, list]:
    found: dict[str, list] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = ["/scene", "/tf", "/events"]
        for _, channel, message, shown in reader.iter_decoded_messages(topics=topics):
            found.setdefault(channel.topic, []).append((message.log_time, shown))
    return found


def read_json(path: Path, topic: str) -> list[dict]:
    with path.open("rb") as file:
        return [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[topic])]


@pytest.mark.slow
def test_viewers_that_come_late_see_the_flight_and_the_record_keeps_all(tmp_path: Path) -> None:
    viewer = start(PLAN, tmp_path / "flight.rrd", "foxglove")
    url = viewer.message.removeprefix("live view: open connection ").removesuffix(" in Foxglove")
    flown = iter(fly(PLAN, duration=30.0))

    def offer() -> None:
        viewer.offer(next(flown))
        for event in events(PLAN)[:1]:
            viewer.offer(event)

    with ExitStack() as stack:
        for _ in range(20):
            offer()
        first = Client(stack, url)
        first.until_topics(TOPICS - {"/margins"}, offer)
        late = Client(stack, url)
        late.until_topics(TOPICS - {"/margins"}, offer)
        assert viewer.close(timeout=PATIENCE)
        while first.read(PATIENCE):
            pass
    assert viewer.dropped == 0
    kept = read_json(tmp_path / "flight.mcap", "/vehicle_2/state")
    seen = [json.loads(data) for topic, data in first.messages if topic == "/vehicle_2/state"]
    later = iter(kept)
    assert seen
    assert all(state in later for state in seen), "what was seen is kept, in the same order"


@pytest.mark.slow
def test_the_record_is_kept_where_the_port_is_taken(tmp_path: Path, monkeypatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        monkeypatch.setattr("swarm.view.feeds.free_port", lambda _: other.getsockname()[1])
        viewer = start(PLAN, tmp_path / "flight.rrd", "foxglove")
        viewer.offer(snapshot_at(PLAN, 40.0))
        assert viewer.close(timeout=PATIENCE)
    assert len(read_json(tmp_path / "flight.mcap", "/vehicle_3/state")) == 1


def test_all_topics_are_announced_before_the_first_moment(tmp_path: Path) -> None:
    """A viewer that is told of one later may subscribe too early, and never see it."""
    viewer = start(PLAN, tmp_path / "flight.rrd", "foxglove")
    deadline = time.monotonic() + PATIENCE
    with ExitStack() as stack:
        client = Client(stack, viewer.message.split()[4])
        while set(client.topics.values()) != TOPICS:
            assert time.monotonic() < deadline, client.topics
            assert client.read(0.1)
    assert viewer.close(timeout=PATIENCE)


def test_foxglove_and_the_console_have_ports_of_their_own() -> None:
    assert parse_address(DEFAULT).port != feeds.FOXGLOVE_PORT


@pytest.mark.slow
def test_figures_are_those_of_the_snapshot(tmp_path: Path) -> None:
    moment = snapshot_at(PLAN, 40.0)
    viewer = start(PLAN, tmp_path / "flight.rrd", "foxglove")
    viewer.offer(moment)
    event = events(PLAN)[0]
    viewer.offer(event)
    assert viewer.close(timeout=PATIENCE)
    path = tmp_path / "flight.mcap"
    (state,) = read_json(path, "/vehicle_3/state")
    assert list(state["position"].values()) == moment.position[2].tolist()
    assert list(state["setpoint"].values()) == moment.setpoint[2].tolist()
    assert state["battery"] == moment.battery[2]
    assert (state["mode"], state["state"]) == (moment.modes[2], moment.states[2])
    assert state["tracking_error"] == pytest.approx(
        np.linalg.norm(moment.position[2] - moment.setpoint[2])
    )
    (mission,) = read_json(path, "/mission")
    assert mission["phase"] == moment.phase
    assert mission["mission_time"] == moment.mission_time
    assert mission["gate"] == (moment.waiting_for or "")
    messages = decoded(path)
    (_, field), (_, drawn) = messages["/scene"]
    assert [entity.id for entity in field.entities] == ["field"]
    assert len(field.entities[0].cylinders) == PLAN.vehicles
    vehicles, cable = drawn.entities
    assert [text.text for text in vehicles.texts] == [str(k + 1) for k in range(PLAN.vehicles)]
    assert len(cable.lines) == PLAN.vehicles - 1
    ((at, log),) = messages["/events"]
    assert log.message == f"{event.kind}: {event.message}"
    stamps = [stamp for stamp, _ in messages["/tf"]]
    assert at - stamps[0] == pytest.approx(1e9 * (event.time - moment.time), abs=2e3)


@pytest.mark.slow
def test_a_second_flight_gets_another_port(tmp_path: Path) -> None:
    messages = []
    viewers = []
    for name in ("a.rrd", "b.rrd"):
        viewers.append(start(PLAN, tmp_path / name, "foxglove"))
        with ExitStack() as stack:
            url = viewers[-1].message.split()[4]
            Client(stack, url)
        messages.append(url)
    assert all(viewer.close(timeout=PATIENCE) for viewer in viewers)
    assert len(set(messages)) == 2
