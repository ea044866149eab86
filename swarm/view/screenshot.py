"""Screenshots of recordings, rendered by Rerun without a screen."""

import io
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from PIL import Image
from rerun.experimental import ViewerClient

from swarm.errors import reason
from swarm.view.viewers import (
    DRIVER,
    Process,
    ViewerFailed,
    ending,
    exit_description,
    free_port,
    proxy_url,
    run_viewer,
)

SETTLE_TIME: Final = 6.0
"""Seconds until a loaded recording is drawn and the viewer's notices have faded."""

RETRY_TIME: Final = 3.0
"""Seconds until the next screenshot. A busy machine draws more slowly, so the result is the first
screenshot that is equal to the one before."""

_EXIT_TIME: Final = 1.0
"""Seconds within which a viewer that does not answer may end by itself."""

MENU: Final = 37
"""Height of the viewer's menu and warnings, which are cut off, in pixels."""


class ScreenshotFailed(ViewerFailed):
    """The viewer returned no screenshot; the message has the reason."""


def screenshot(
    sources: Sequence[Path],
    picture: Path,
    *,
    at: float | None = None,
    size: tuple[int, int] = (1280, 720),
    view: str | None = None,
    timeout: float = 60.0,
) -> None:
    """Render a recording to a PNG without a screen.

    ``sources`` are its file (.rrd) and optionally blueprints (.rbl). ``at`` is the time in seconds
    on the recording's timeline (None: the start), ``view`` the name of a single view. It needs a
    Vulkan driver; Mesa's software driver suffices. Raises :class:`ScreenshotFailed` without a
    screenshot within ``timeout`` seconds, and OSError where ``picture`` cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="swarm-", ignore_cleanup_errors=True) as folder:
        port = free_port()
        arguments = [
            *("--headless", "--hide-welcome-screen", "--port", str(port)),
            *("--window-size", f"{size[0]}x{size[1]}", *map(str, sources)),
        ]
        until = time.monotonic() + timeout
        with ending(run_viewer(arguments, folder=Path(folder))) as viewer:
            try:
                png = _take_screenshot(viewer, port, at, view, until)
            except (RuntimeError, OSError) as error:
                raise ScreenshotFailed(_reason(viewer, Path(folder), error)) from None
    try:
        shown: Image.Image = Image.open(io.BytesIO(png))
    except OSError as error:
        raise ScreenshotFailed(f"the viewer's screenshot cannot be read: {reason(error)}") from None
    if view is None:
        shown = shown.crop((0, MENU, *shown.size))
    # A palette of 256 colours needs a third of the bytes, without a visible difference.
    shown.convert("RGB").quantize(256).save(picture, format="PNG", optimize=True)


def _take_screenshot(
    viewer: Process, port: int, at: float | None, view: str | None, until: float
) -> bytes:
    client = _connected(viewer, port, until)
    _wait_loaded(client, until)
    client.set_time(duration=at or 0.0, play_state="paused")
    time.sleep(SETTLE_TIME)
    return _settled(client, _view_id(client, view), until)


def _reason(viewer: Process, folder: Path, error: Exception) -> str:
    """Return the viewer's last message if it has exit_description, or the error of its library."""
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(_EXIT_TIME)
        return f"{exit_description(viewer, folder)}; {DRIVER}"
    return f"the viewer returned no screenshot: {reason(error)}"


def _settled(client: ViewerClient, view: str | None, until: float) -> bytes:
    before, png = b"", bytes(client.take_screenshot(view))
    while png != before and time.monotonic() < until:
        time.sleep(RETRY_TIME)
        before, png = png, bytes(client.take_screenshot(view))
    return png


def _view_id(client: ViewerClient, name: str | None) -> str | None:
    if name is None:
        return None
    return find_view({shown.name: shown.view_id for shown in client.get_state().views}, name)


def find_view(views: Mapping[str, str], name: str) -> str:
    """Return the id of the view with a name, in upper or lower case.

    Raises :class:`ScreenshotFailed` with all names where there is none.
    """
    for shown, view in views.items():
        if shown.casefold() == name.strip().casefold():
            return view
    names = "; ".join(sorted(views)) or "none"
    raise ScreenshotFailed(f"--only: expected one of the views ({names}), got {name}")


def _connected(viewer: Process, port: int, until: float) -> ViewerClient:
    while time.monotonic() < until and viewer.poll() is None:
        try:
            client = ViewerClient.connect(proxy_url(port))
            client.get_state()
        except (RuntimeError, ConnectionError):
            time.sleep(0.2)
        else:
            return client
    raise TimeoutError(f"it did not start in time; {DRIVER}")


def _wait_loaded(client: ViewerClient, until: float) -> None:
    while time.monotonic() < until:
        state = client.get_state()
        if state.recordings and state.recordings[0].timelines and not state.loading:
            return
        time.sleep(0.2)
    raise ScreenshotFailed("the viewer did not load the recording in time")
