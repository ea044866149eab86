"""Compiled functions are compiled again when their sources have changed."""

import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import sitl
import swarm
from swarm import jit, precompile
from swarm.geometry.distance import dot
from swarm.jit import key, sealed

PACKAGE = {
    "inner.py": (
        "from swarm.jit import compiled\nfrom swarm.numbers import STEP\n\n"
        "@compiled\ndef inner(x):\n    return x + STEP\n"
    ),
    "numbers.py": "from swarm.folder import STEP\n\nTIMES = 2\n",
    "folder/__init__.py": "STEP = 1\n",
    "outer.py": (
        "from swarm import inner, numbers\nfrom swarm.jit import compiled\n\n"
        "@compiled\ndef outer(x):\n    return numbers.TIMES * inner.inner(x)\n\nprint(outer(20))\n"
    ),
    "aside.py": "STEP = 1\n",
}
"""A small package of the same name, whose compiled functions use each other through modules."""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    for name, text in PACKAGE.items():
        (tmp_path / "swarm" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "swarm" / name).write_text(text)
    for name in ("__init__.py", "jit.py", "signatures.py", "version.py"):
        shutil.copy(Path(jit.__file__).parent / name, tmp_path / "swarm" / name)
    return tmp_path


def run(folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-B", "-m", "swarm.outer"],
        env=os.environ | {"XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": str(folder)},
        cwd=folder, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def kept(folder: Path) -> set[Path]:
    return set((folder / "cache").rglob("*.nbi"))


CHANGES = (
    ("inner.py", "x + STEP", "x + STEP + 2", "46"),  # a function, reached through its module
    ("numbers.py", "TIMES = 2", "TIMES = 3", "69"),  # a constant, reached through its module
    ("folder/__init__.py", "STEP = 1", "STEP = 5", "81"),  # imported by an imported module
)


@pytest.mark.slow
def test_machine_code_is_used_again_until_what_it_is_made_of_changes(package):
    assert run(package) == "42"
    before, folders = kept(package), list((package / "cache" / "swarm").iterdir())
    assert before
    assert len(folders) == 2  # one for each file with compiled functions
    then = time.time() - (jit.KEPT - 1) * 86400
    for folder in folders:
        os.utime(folder, (then, then))
    (package / "swarm" / "aside.py").write_text("STEP = 2\n")  # no module imports it
    assert run(package) == "42"
    assert kept(package) == before
    assert all(time.time() - folder.stat().st_mtime < 86400 for folder in folders), "last use"
    for name, before, after, result in CHANGES:
        file = package / "swarm" / name
        file.write_text(file.read_text().replace(before, after))
        assert run(package) == result


def test_the_first_compilation_registers_no_more_types_of_arguments():
    script = (
        "from numba.core.registry import cpu_target\n"
        "from numba.core.typing.typeof import typeof_impl\n"
        "from swarm import jit\n"
        "before = set(typeof_impl.registry)\n"
        "cpu_target.target_context.refresh()\n"
        "print(set(typeof_impl.registry) - before)\n"
    )
    found = subprocess.check_output([sys.executable, "-B", "-c", script], text=True)
    assert found.strip() == "set()"


@pytest.mark.slow
def test_a_script_is_compiled_again_when_a_file_beside_it_has_changed(tmp_path):
    (tmp_path / "constant.py").write_text("STEP = 1\n")
    script = tmp_path / "script.py"
    script.write_text(
        "from swarm.jit import compiled\nfrom constant import STEP\n\n"
        "@compiled\ndef add(x):\n    return x + STEP\n\nprint(add(1))\n"
    )

    def result() -> str:
        root = str(Path(jit.__file__).parents[1])
        environment = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": root}
        command = [sys.executable, "-B", str(script)]
        return subprocess.check_output(command, env=os.environ | environment, text=True).strip()

    assert result() == "2"
    assert kept(tmp_path)
    (tmp_path / "constant.py").write_text("STEP = 2\n")
    assert result() == "3"


def test_a_file_that_has_changed_since_it_was_imported_has_no_key(tmp_path):
    file = tmp_path / "later.py"
    file.write_text("from swarm.jit import compiled\n")
    with pytest.raises(OSError, match="has changed since this process started"):
        jit.key(str(file))


@pytest.mark.parametrize(
    ("owner", "name", "value"),
    [
        (jit.numba, "__version__", "99"),
        (jit.llvmlite, "__version__", "99"),
        (jit.sys, "version", "99"),
        (jit.llvmlite.binding, "get_host_cpu_name", lambda: "another"),
    ],
)
def test_the_versions_and_the_processor_are_part_of_the_key(monkeypatch, owner, name, value):
    before = jit.key(jit.__file__)
    monkeypatch.setattr(owner, name, value)
    jit.compiler.cache_clear()
    jit.key.cache_clear()
    changed = jit.key(jit.__file__)
    monkeypatch.undo()
    jit.compiler.cache_clear()
    jit.key.cache_clear()
    assert before == jit.key(jit.__file__) != changed


def test_machine_code_that_was_not_used_for_long_is_removed(tmp_path):
    ages = {"new": 0.0, "used": jit.KEPT - 1, "old": jit.KEPT + 1}
    for name, days in ages.items():
        (tmp_path / name / "place").mkdir(parents=True)
        (tmp_path / name / "place" / "code.nbc").write_text("")
        (tmp_path / f"tests-{name}").write_text("")
        then = time.time() - days * 86400
        for path in (tmp_path / name, tmp_path / f"tests-{name}"):
            os.utime(path, (then, then))
    jit.prune(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "new", "tests-new", "tests-used", "used",
    ]  # fmt: skip
    jit.prune(tmp_path / "missing")


def test_functions_compile_without_a_cache(package: Path) -> None:
    (package / "cache").write_text("not a folder")
    assert run(package) == "42"


def test_another_installation_of_the_same_sources_is_compiled_beforehand_too(tmp_path, monkeypatch):
    """Numba finds machine code by the path and the time of its file, and we leave out what it has."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = "from swarm.jit import compiled\n\n@compiled\ndef one(x):\n    return x\n"
    marks = []
    for folder, changed in (("first", 1e9), ("second", 1e9), ("second", 1.1e9), ("second", 1.1e9)):
        path = tmp_path / folder / "twice_installed.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(source)
        os.utime(path, (changed, changed))
        key.cache_clear()
        monkeypatch.setattr(
            precompile, "_files", lambda _, path=path: {"twice_installed": str(path)}
        )
        marks.append(precompile._mark("twice_installed"))
    assert None not in marks
    assert len({*marks[:3]}) == 3
    assert marks[2] == marks[3]


def test_an_inner_function_can_be_called_from_python_but_not_in_flight() -> None:
    assert dot((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)) == 32.0
    assert jit.declared(dot) is None
    with sealed(), pytest.warns(RuntimeWarning, match=r"distance\.dot is interpreted"):
        assert dot((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)) == 32.0


def compiled_functions() -> Iterator[Any]:
    for package in (swarm, sitl):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "jit import" in Path(module.module_finder.find_spec(module.name).origin).read_text():
                found = vars(importlib.import_module(module.name)).values()
                yield from (one for one in found if isinstance(one, Dispatcher))


def has_arrays(annotation: Any) -> bool:
    if np.ndarray in (annotation, get_origin(annotation)):
        return True
    fields = get_type_hints(annotation).values() if hasattr(annotation, "_fields") else ()
    return any(has_arrays(part) for part in (*get_args(annotation), *fields))


def makes_arrays(function: Dispatcher) -> bool:
    return has_arrays(get_type_hints(function.py_func).get("return"))


def test_functions_that_return_arrays_or_use_such_count_references() -> None:
    """Without counts the compiler refuses to make arrays, but not to leak those of others."""
    functions = set(compiled_functions())
    assert len(functions) > 300
    counting = {one for one in functions if vars(one.py_func).get("allocates")}
    makers = {one for one in functions if makes_arrays(one)}
    users = {
        one
        for one in functions
        for name in one.py_func.__code__.co_names
        if any(one.py_func.__globals__.get(name) is made for made in makers)
    }
    assert len(makers) >= 3
    assert users - makers
    assert (makers | users) - counting == set()
