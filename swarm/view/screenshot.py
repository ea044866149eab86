"""Pictures of recordings, rendered by Rerun without a screen."""

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
    ended,
    ending,
    free_port,
    proxy_url,
    run_viewer,
)

SETTLED: Final = 6.0
"""Seconds until a loaded recording is drawn and the viewer's own notices have faded."""

AGAIN: Final = 3.0
"""Seconds until the next picture: on a busy machine all of that takes longer, and what is taken is
the first picture that is like the one before."""

_LAST_WORDS: Final = 1.0
"""Seconds that a viewer which no longer answers may take to end."""

MENU: Final = 37
"""Height of the viewer's menu and warnings, which are no part of the picture, in pixels."""


class NoPicture(ViewerFailed):
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
    :class:`NoPicture` where none comes within ``patience`` seconds, and OSError where ``picture``
    cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="swarm-", ignore_cleanup_errors=True) as folder:
        port = free_port()
        arguments = [
            *("--headless", "--hide-welcome-screen", "--port", str(port)),
            *("--window-size", f"{size[0]}x{size[1]}", *map(str, sources)),
        ]
        until = time.monotonic() + patience
        with ending(run_viewer(arguments, folder=Path(folder))) as viewer:
            try:
                png = _taken(viewer, port, at, view, until)
            except (RuntimeError, OSError) as error:
                raise NoPicture(_why(viewer, Path(folder), error)) from None
    try:
        shown: Image.Image = Image.open(io.BytesIO(png))
    except OSError as error:
        raise NoPicture(f"the viewer's picture cannot be read: {reason(error)}") from None
    if view is None:
        shown = shown.crop((0, MENU, *shown.size))
    # A palette of 256 colours: a third of the bytes, and nobody sees it.
    shown.convert("RGB").quantize(256).save(picture, format="PNG", optimize=True)


def _taken(viewer: Process, port: int, at: float | None, view: str | None, until: float) -> bytes:
    client = _connected(viewer, port, until)
    _wait_loaded(client, until)
    client.set_time(duration=at or 0.0, play_state="paused")
    time.sleep(SETTLED)
    return _settled(client, _view_id(client, view), until)


def _why(viewer: Process, folder: Path, error: Exception) -> str:
    """Why there is no picture: what the viewer said if it has ended, or what its library says."""
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(_LAST_WORDS)
        return f"{ended(viewer, folder)}; {DRIVER}"
    return f"the viewer gave no picture: {reason(error)}"


def _settled(client: ViewerClient, view: str | None, until: float) -> bytes:
    before, png = b"", bytes(client.take_screenshot(view))
    while png != before and time.monotonic() < until:
        time.sleep(AGAIN)
        before, png = png, bytes(client.take_screenshot(view))
    return png


def _view_id(client: ViewerClient, name: str | None) -> str | None:
    if name is None:
        return None
    return chosen({shown.name: shown.view_id for shown in client.get_state().views}, name)


def chosen(views: Mapping[str, str], name: str) -> str:
    """Return the id of the view of that name, in whatever case it is written.

    Raises :class:`NoPicture` with all names where there is none.
    """
    for shown, view in views.items():
        if shown.casefold() == name.strip().casefold():
            return view
    names = "; ".join(sorted(views)) or "none"
    raise NoPicture(f"--only: expected one of the views ({names}), got {name}")


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
    raise NoPicture("the viewer did not load the recording in time")
