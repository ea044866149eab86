"""The process that writes a flight to one Rerun recording: ``python -m swarm.view.rerun_sink``.

It reads pickles from its standard input: the plan and the output, then snapshots and events. At the
end of the input, also a broken one, it completes the recording.
"""

import os
import sys

import rerun as rr

from swarm.flight.snapshot import Event
from swarm.view.blueprint import flight_blueprint
from swarm.view.feeds import first_item, items
from swarm.view.replay import send_planned
from swarm.view.rerun_scene import Recorder
from swarm.view.viewers import open_window, proxy_url, serve

FLUSH = 5.0
"""Seconds within which the end of a live recording reaches the server."""


def main() -> None:
    """Record what arrives on standard input."""
    source = sys.stdin.buffer
    plan, options = first_item(source)
    stream = rr.RecordingStream("swarm")
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    server = None
    if options.path is not None:
        stream.save(options.path, default_blueprint=flight_blueprint(plan, live=False))
    else:
        # Viewers may connect late: the server keeps earlier data. The plan's motion is left out,
        # because a live view is not compared with the plan.
        server = serve(options.port, options.web_port)
        url = proxy_url(options.port)
        stream.connect_grpc(url, default_blueprint=flight_blueprint(plan, live=True))
        if options.live == "native":
            open_window("--connect", url)
    stream.send_recording_name(plan.mission.name)
    if server is None:
        send_planned(stream, plan)
    recorder = Recorder(stream, plan)
    for item in items(source):
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
    # Without the interpreter's shutdown, in which the library waits for closed viewers.
    os._exit(0)


if __name__ == "__main__":
    main()
