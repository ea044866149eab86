"""Pictures of recordings, rendered by Rerun without a screen."""

import time
from pathlib import Path

from rerun.experimental import ViewerClient

from swarm.view.viewers import Process, free_port, proxy_url, run_viewer


def screenshot(
    recording: Path,
    picture: Path,
    *,
    at: float | None = None,
    timeline: str = "time",
    size: tuple[int, int] = (1280, 720),
    view: str | None = None,
    patience: float = 60.0,
) -> None:
    """Render a recording to a PNG without a screen.

    ``at`` is the moment in seconds on ``timeline`` (None: the end), ``view`` the name of one view
    instead of the whole window. Needs a Vulkan driver; Mesa's software one will do. Raises
    :class:`RuntimeError` when no picture comes within ``patience`` seconds.
    """
    port = free_port()
    viewer = run_viewer(
        [
            *("--headless", "--hide-welcome-screen", "--port", str(port)),
            *("--window-size", f"{size[0]}x{size[1]}", str(recording)),
        ]
    )
    until = time.monotonic() + patience
    try:
        client = _connected(viewer, port, until)
        _wait_loaded(client, until)
        moment = {} if at is None else {"duration": at}
        client.set_time(timeline, play_state="paused", **moment)
        time.sleep(6.0)
        views = {shown.name: shown.view_id for shown in client.get_state().views}
        png = client.take_screenshot(None if view is None else views[view])
    finally:
        viewer.kill()
        viewer.wait()
    picture.write_bytes(png)


def _connected(viewer: Process, port: int, until: float) -> ViewerClient:
    while time.monotonic() < until:
        if viewer.poll() is not None:
            break
        try:
            client = ViewerClient.connect(proxy_url(port))
            client.get_state()
        except (RuntimeError, ConnectionError):
            time.sleep(0.2)
        else:
            return client
    raise RuntimeError("the viewer did not start (is a Vulkan driver installed?)")


def _wait_loaded(client: ViewerClient, until: float) -> None:
    while time.monotonic() < until:
        state = client.get_state()
        if state.recordings and state.recordings[0].timelines and not state.loading:
            return
        time.sleep(0.2)
    raise RuntimeError("the viewer did not load the recording in time")
