"""Rerun recordings of plans and flights, and the viewer's window."""

import atexit
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from swarm.files import require_writable


@dataclass(frozen=True, repr=False)
class Recording:
    """A Rerun recording in a file.

    ``path`` is the file; ``shown`` is true if a viewer opened it.
    """

    path: Path
    shown: bool

    @classmethod
    def written(
        cls, write: Callable[[Path], None], path: str | os.PathLike[str] | None = None
    ) -> Self:
        """Write a recording to ``path`` or to a temporary file, and open it in the viewer.

        The temporary file is deleted when Python ends. Raises :class:`InputError` where the file
        cannot be written. Warns without a display.
        """
        from swarm.view.viewers import has_display, open_window  # noqa: PLC0415 - slow to import

        file = _temporary() if path is None else Path(path)
        require_writable(file)  # Rerun only logs that it cannot write
        write(file)
        shown = has_display()
        if shown:
            open_window(str(file))
        else:
            warnings.warn(
                "no display here, so no viewer is opened; view(path) writes the recording for "
                "another machine, and `swarm view PATH --web` serves it as a web page",
                stacklevel=3,
            )
        return cls(file, shown)

    def __repr__(self) -> str:
        return f"<Recording {self.path}{'' if self.shown else ': not shown'}>"


def _temporary() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="swarm-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder / "recording.rrd"
