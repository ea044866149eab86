"""The house's own rules: style, types and import order, run by the tools that know them."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted(path for name in ("swarm", "sitl") for path in (ROOT / name).rglob("*.py"))
REASONED = ("geometry", "certification", "folding", "planning", "planner", "flight")
"""Packages of `swarm` in which every numeric constant of a module has its reason beside it."""


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
        pytest.param(["mypy"], marks=pytest.mark.slow),
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


def named(path: Path, node: ast.stmt | ast.expr) -> str:
    return f"{path.relative_to(ROOT)}:{node.lineno}"


def numeric(value: ast.expr | None) -> bool:
    """Whether numbers are written in an expression: itself, in a collection, or as arguments."""
    match value:
        case ast.Constant():
            return isinstance(value.value, int | float) and not isinstance(value.value, bool)
        case ast.UnaryOp():
            parts = [value.operand]
        case ast.BinOp():
            parts = [value.left, value.right]
        case ast.Tuple() | ast.List():
            parts = value.elts
        case ast.Dict():
            parts = value.values
        case ast.Call():
            parts = value.args
        case _:
            parts = []
    return any(numeric(each) for each in parts)


def unreasoned(text: str) -> Iterator[str]:
    """Yield the numeric constants of a module without a docstring after or a comment before them."""
    lines, body = text.splitlines(), ast.parse(text).body
    for node, following in zip(body, [*body[1:], None], strict=True):
        if not (isinstance(node, ast.Assign | ast.AnnAssign) and numeric(node.value)):
            continue
        described = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        above = lines[node.lineno - 2].startswith("#") if node.lineno > 1 else False
        if not (described or above):
            yield lines[node.lineno - 1]


def test_every_numeric_constant_has_its_reason() -> None:
    paths = [path for name in REASONED for path in sorted((ROOT / "swarm" / name).rglob("*.py"))]
    assert len(paths) > 100
    found = {path: list(unreasoned(path.read_text(encoding="utf-8"))) for path in paths}
    assert {path: lines for path, lines in found.items() if lines} == {}


def test_a_constant_without_a_reason_is_found() -> None:
    module = 'A = 1.0\n\nB = 2, 3\n"""Metres."""\n# Seconds.\nC = f(4)\nD = -5\nE = "text"\n'
    assert list(unreasoned(module)) == ["A = 1.0", "D = -5"]
