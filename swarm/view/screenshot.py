"""Pictures of recordings, rendered by Rerun without a screen."""

import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from PIL import Image
from rerun.experimental import ViewerClient

from swarm.view.viewers import Process, free_port, proxy_url, run_viewer

SETTLED: Final = 6.0
"""Seconds until a loaded recording is drawn and the viewer's own notices have faded."""

AGAIN: Final = 3.0
"""Seconds until the next picture: on a busy machine all of that takes longer, and what is taken is
the first picture that is like the one before."""

MENU: Final = 37
"""Height of the viewer's menu and warnings, which are no part of the picture, in pixels."""


class NoPicture(Exception):  # noqa: N818 - it says what there is not
    """The viewer gave no picture, and why."""


def screenshot(
    sources: Sequence[Path],
    picture: Path,
    *,
    at: float | None = None,
    size: tuple[int, int] = (1280, 720),
    view: str | None = None,
    patience: float = 60.0,
) -> None:
    """Render a recording to a PNG without a screen.

    ``sources`` are its file (.rrd) and any blueprint (.rbl) to arrange it by; ``at`` is the moment
    in seconds on the recording's own timeline (None: the beginning), ``view`` the name of one view
    instead of the whole window. Needs a Vulkan driver; Mesa's software one will do. Raises
    :class:`NoPicture` where none comes within ``patience`` seconds.
    """
    port = free_port()
    viewer = run_viewer(
        [
            *("--headless", "--hide-welcome-screen", "--port", str(port)),
            *("--window-size", f"{size[0]}x{size[1]}", *map(str, sources)),
        ]
    )
    until = time.monotonic() + patience
    try:
        client = _connected(viewer, port, until)
        _wait_loaded(client, until)
        client.set_time(duration=at or 0.0, play_state="paused")
        time.sleep(SETTLED)
        png = _settled(client, _view_id(client, view), until)
    except RuntimeError as error:
        raise NoPicture(f"the viewer gave no picture: {error}") from None
    finally:
        viewer.kill()
        viewer.wait()
    shown: Image.Image = Image.open(io.BytesIO(png))
    if view is None:
        shown = shown.crop((0, MENU, *shown.size))
    # A palette of 256 colours: a third of the bytes, and nobody sees it.
    shown.convert("RGB").quantize(256).save(picture, format="PNG", optimize=True)


def _settled(client: ViewerClient, view: str | None, until: float) -> bytes:
    before, png = b"", bytes(client.take_screenshot(view))
    while png != before and time.monotonic() < until:
        time.sleep(AGAIN)
        before, png = png, bytes(client.take_screenshot(view))
    return png


def _view_id(client: ViewerClient, name: str | None) -> str | None:
    if name is None:
        return None
    views: dict[str, str] = {shown.name: shown.view_id for shown in client.get_state().views}
    if name not in views:
        raise NoPicture(f"expected one of the views {', '.join(sorted(views))}, got {name}")
    return views[name]


def _connected(viewer: Process, port: int, until: float) -> ViewerClient:
    while time.monotonic() < until and viewer.poll() is None:
        try:
            client = ViewerClient.connect(proxy_url(port))
            client.get_state()
        except (RuntimeError, ConnectionError):
            time.sleep(0.2)
        else:
            return client
    raise NoPicture(
        "the viewer did not start; without a graphics card it needs a software driver "
        "(Debian, Ubuntu: mesa-vulkan-drivers)"
    )


def _wait_loaded(client: ViewerClient, until: float) -> None:
    while time.monotonic() < until:
        state = client.get_state()
        if state.recordings and state.recordings[0].timelines and not state.loading:
            return
        time.sleep(0.2)
    raise NoPicture("the viewer did not load the recording in time")
