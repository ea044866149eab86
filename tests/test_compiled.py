"""Compiled functions are made anew when what they were made from has changed."""

import os
import subprocess
import sys
from pathlib import Path

INNER = "from swarm.compiled import compiled\n\n@compiled\ndef inner(x):\n    return x + {}\n"
OUTER = (
    "from inner import inner\nfrom swarm.compiled import compiled\n\n"
    "@compiled\ndef outer(x):\n    return 2 * inner(x)\n\nprint(outer(20))\n"
)


def run(folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-B", "outer.py"],
        env=os.environ | {"XDG_CACHE_HOME": str(folder / "cache")},
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def test_a_change_in_a_function_that_is_called_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(OUTER)
    (tmp_path / "inner.py").write_text(INNER.format(1))
    assert run(tmp_path) == "42"
    assert list((tmp_path / "cache" / "swarm").rglob("*outer*.nbi"))
    (tmp_path / "inner.py").write_text(INNER.format(2))
    assert run(tmp_path) == "44"


def test_without_a_cache_it_is_compiled_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(OUTER)
    (tmp_path / "inner.py").write_text(INNER.format(1))
    (tmp_path / "cache").write_text("not a folder")
    assert run(tmp_path) == "42"
