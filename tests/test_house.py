"""The house's own rules: style, types and import order, run by the tools that know them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        ["mypy"],
        ["lint-imports"],
    ],
    ids=" ".join,
)
def test_house_rule(command: list[str]) -> None:
    tool, *arguments = command
    script = Path(sys.executable).parent / tool
    result = subprocess.run(
        [script, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_readme_gives_the_test_command_that_ci_runs() -> None:
    readme = (ROOT / "README.md").read_text()
    assert readme.count("<!-- test command -->") == 1
    assert "<!-- test command -->" in (ROOT / ".ci" / "run").read_text()
