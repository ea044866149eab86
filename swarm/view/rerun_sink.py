"""The process that turns a flight into one Rerun recording: ``python -m swarm.view.rerun_sink``.

It reads pickles from its standard input (the plan and where to put it, then snapshots and events)
until that ends, however it ends: then the recording is completed.
"""

import os
import pickle
import sys
from collections.abc import Iterator
from typing import BinaryIO

import rerun as rr

from swarm.flight.snapshot import Event, Snapshot
from swarm.planning import Plan
from swarm.view.blueprint import flight_blueprint
from swarm.view.replay import send_planned
from swarm.view.rerun_log import SinkOptions
from swarm.view.rerun_scene import Recorder
from swarm.view.viewers import open_window, proxy_url, serve

FLUSH = 5.0
"""Seconds that the last of a live recording may take to reach the server."""


def main() -> None:
    """Record what arrives on standard input."""
    source = sys.stdin.buffer
    plan: Plan
    options: SinkOptions
    plan, options = pickle.load(source)  # noqa: S301 - written by the process that started us
    stream = rr.RecordingStream("swarm")
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    server = None
    if options.path is not None:
        stream.save(options.path, default_blueprint=flight_blueprint(plan, live=False))
    else:
        # Viewers may come late: the server keeps what was logged before. It is no file, so nobody
        # compares it with the plan, and the plan's motion is left out.
        server = serve(options.port, options.web_port)
        url = proxy_url(options.port)
        stream.connect_grpc(url, default_blueprint=flight_blueprint(plan, live=True))
        if options.live == "native":
            open_window("--connect", url)
    stream.send_recording_name(plan.mission.name)
    if server is None:
        send_planned(stream, plan)
    recorder = Recorder(stream, plan)
    for item in _items(source):
        if isinstance(item, Event):
            recorder.event(item)
        else:
            recorder.snapshot(item)
    recorder.finish()
    if server is None:
        stream.disconnect()
    else:
        stream.flush(timeout_sec=FLUSH)
        server.terminate()
    # Not through the interpreter's end, where the library waits for viewers that are gone.
    os._exit(0)


def _items(source: BinaryIO) -> Iterator[Snapshot | Event]:
    while True:
        try:
            yield pickle.load(source)  # noqa: S301 - as above
        except (EOFError, pickle.UnpicklingError):
            return


if __name__ == "__main__":
    main()
