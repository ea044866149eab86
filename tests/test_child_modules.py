"""Child processes import the same code as their parent, whatever the current folder is."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from swarm.child_modules import module_command


@pytest.fixture
def decoys(tmp_path: Path) -> Path:
    """A folder with other packages of the same names, as a checkout of another version has."""
    for name in ("swarm", "sitl"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise SystemExit('another version')\n")
    return tmp_path


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_a_module_is_not_imported_from_the_current_folder(decoys: Path) -> None:
    plain = run([sys.executable, "-m", "sitl", "--help"], decoys)
    if "PYTHONPATH" not in os.environ:
        assert plain.stderr.strip() == "another version", "the decoy lies where Python looks first"
    found = run(module_command("sitl", "--help"), decoys)
    assert found.returncode == 0, found.stderr
    assert "--world" in found.stdout


def test_a_module_gets_its_arguments_and_runs_as_the_main_one(tmp_path: Path) -> None:
    refused = run(module_command("sitl", "--no-such-option"), tmp_path)
    assert refused.returncode == 2
    assert "--no-such-option" in refused.stderr


@pytest.mark.slow
def test_machine_code_is_compiled_for_the_files_that_are_used(decoys: Path) -> None:
    """Compiled for a checkout in the current folder, the installed files would have none."""
    program = (
        "import sys; from swarm import precompile; from swarm.geometry.catenary import _solve_all\n"
        "precompile.prepare(['swarm.geometry.catenary'])\n"
        "_solve_all.compile(precompile.declared(_solve_all))\n"
        "print(sum(_solve_all.stats.cache_hits.values()))\n"
    )
    code = f"import sys; sys.path[:] = {sys.path!r}\n{program}"
    environment = os.environ | {"XDG_CACHE_HOME": str(decoys / "cache")}
    found = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=decoys, env=environment, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert found.stdout == "1\n", found.stderr
