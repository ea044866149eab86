"""Commands that start modules of this project as child processes."""

import sys


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module, as ``python -m`` does, with the code of this process.

    ``python -m`` alone would import from the current folder first: from a checkout beside the
    installed version, or from whatever else lies in a folder with one of these names.
    """
    # the module first, where lists of processes show it
    code = (
        f"module = {module!r}; import runpy, sys; sys.path[:] = {sys.path!r}; "
        "runpy.run_module(module, run_name='__main__', alter_sys=True)"
    )
    return [sys.executable, "-P", "-c", code, *arguments]
