"""The program, run in this process: starting another one takes longer than most commands do."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import NamedTuple
from unittest import mock

import pytest

from swarm.cli.main import main


class Said(NamedTuple):
    """What a command printed, and the code that it ended with."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments: str) -> Said:
    """Run the program with arguments, as its entry point does."""
    out, err = StringIO(), StringIO()
    with (
        mock.patch.object(sys, "argv", ["swarm", *arguments]),
        redirect_stdout(out),
        redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    code = ended.value.code
    assert isinstance(code, int)
    return Said(code, out.getvalue(), err.getvalue())
