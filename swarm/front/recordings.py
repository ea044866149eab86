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

from swarm.errors import InputError, Problem, reason


@dataclass(frozen=True, repr=False)
class Recording:
    """A Rerun recording in a file.

    ``path`` is the file; ``shown`` says whether a viewer's window was opened for it.
    """

    path: Path
    shown: bool

    @classmethod
    def made(
        cls, write: Callable[[Path], None], path: str | os.PathLike[str] | None = None
    ) -> Self:
        """Write a recording to ``path``, or to a file that lasts as long as Python, and open it.

        Raises :class:`InputError` where the file cannot be written. Warns where nothing is opened.
        """
        from swarm.view.viewers import has_display, open_window  # noqa: PLC0415 - slow to import

        file = _temporary() if path is None else Path(path)
        _require_writable(file)
        write(file)
        shown = has_display()
        if shown:
            open_window(str(file))
        else:
            warnings.warn(
                "no display here, so no viewer is opened; view(path) keeps the recording for "
                "another machine, and `swarm view PATH --web` shows it as a page",
                stacklevel=3,
            )
        return cls(file, shown)

    def __repr__(self) -> str:
        return f"<Recording {self.path}{'' if self.shown else ': not shown'}>"


def _temporary() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="swarm-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder / "recording.rrd"


def _require_writable(path: Path) -> None:
    """Raise :class:`InputError` where a file cannot be written; Rerun would only log that."""
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputError([Problem(str(path), reason(error))]) from None
