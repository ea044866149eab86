"""Commands of one purpose: their help, the old spellings, and completion in shells."""

import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import BashComplete

from sitl.__main__ import command as emulator
from swarm.cli.main import COMMANDS, SECTIONS, VARIABLE, cli, current_spelling
from tests.command import run

PROGRAM = Path(sys.executable).parent / "swarm"
HOVER = "missions/first-steps/hover.yaml"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("dry-run M", "dry-run M"),
        ("dry-run M --trial 17 --scenario S", "dry-run M --trial 17 --scenario S"),
        ("dry-run M --trials 9 --results R", "trials M --count 9 --output R"),
        ("dry-run --trials=9 M --compare", "trials --count=9 M --compare"),
        (
            "dry-run M --failures --row motor --times 1 --results=R",
            "failures M --filter motor --repeat 1 --output=R",
        ),
        ("dry-run --rope M --links 40", "rope M --links 40"),
        ("knots --plan --only 3_1 --to R", "knots --plan --filter 3_1 --output R"),
        ("view M --only Knot", "view M --only Knot"),
        ("", ""),
    ],
)
def test_old_spellings_become_new_ones(old, new):
    assert current_spelling(old.split()) == new.split()


def test_an_old_spelling_works_with_a_note_on_stderr():
    result = run("dry-run", HOVER, "--failures", "--row", "no such case")
    assert result.returncode == 2
    note, error = result.stderr.splitlines()[0], result.stderr.splitlines()[-1]
    assert note == f"note: the new spelling is: swarm failures {HOVER} --filter 'no such case'"
    assert error.startswith("--filter: expected a part of one of: ")
    new = run("failures", HOVER, "--filter", "no such case")
    assert "note" not in new.stderr
    assert new.stderr.splitlines()[-1] == error


def test_two_purposes_at_once_are_refused():
    result = run("dry-run", HOVER, "--trials", "2", "--rope")
    assert result.returncode == 2
    assert "No such option" in result.stderr
    assert "--rope" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["failures", "--seed", "3", "--output", "r"],
            "--seed, --output: expected a MISSION to fly failure tests on",
        ),
        (
            ["failures", HOVER, "--table"],
            "--table and --diagram are of the responses: leave MISSION out",
        ),
        (
            ["trials", HOVER, "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"],
            "--jobs and --scheduler do not go together",
        ),
        (["fly", "--resume", "r", "--scenario", "s"], "--resume and --scenario do not go together"),
        (
            ["dry-run", HOVER, "--scenario", "s", "--trial", "0", "--no-cable"],
            "--no-cable and --trial do not go together",
        ),
        (
            ["dry-run", HOVER, "--cable", "static", "--no-cable"],
            "--cable and --no-cable do not go together",
        ),
        (["rope", HOVER, "--compare", "--flown", "r"], "--compare and --flown do not go together"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_options_that_contradict_are_refused_before_anything_is_planned(arguments, message):
    result = run(*arguments)
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr


def test_failures_without_a_mission_prints_the_responses():
    result = run("failures")
    assert result.returncode == 0
    assert "battery" in result.stdout
    assert "stateDiagram" in run("failures", "--diagram").stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_an_example_with_options_that_exist(name):
    command = emulator if name == "sitl" else cli.get_command(click.Context(cli), name)
    assert command is not None
    *_, example = inspect.cleandoc(command.help or "").split("\n\n")
    assert example.startswith(f"Example: swarm {name}")
    known = {option for one in command.params for option in one.opts}
    assert {word for word in example.split() if word.startswith("-")} <= known


def test_help_lists_commands_in_sections_with_an_example_each():
    listed = run("--help").stdout
    assert listed.count("Example: swarm") == 1 + len(SECTIONS)
    assert all(f"\n{title}:\n" in listed for title in SECTIONS)


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("f", ["failures", "fly", "flights"]),
        ("trials --out", ["--output"]),
        ("dry-run --cable ", ["swinging", "static"]),
        ("plan 8_2", ["8_2 (file)", "8_2", "8_20", "8_21"]),
    ],
)
def test_completion_offers_commands_options_and_knots(words, offered):
    *before, last = words.split(" ")
    found = BashComplete(cli, {}, "swarm", VARIABLE).get_completions(before, last)
    shown = [one.value + (" (file)" if one.type == "file" else "") for one in found]
    assert shown == offered


def test_the_installed_program_answers_its_completion_script():
    asked = {VARIABLE: "bash_complete", "COMP_WORDS": "swarm f", "COMP_CWORD": "1"}
    said = subprocess.run(
        [PROGRAM], capture_output=True, text=True, check=True, env=os.environ | asked
    )
    assert (said.stdout, said.stderr) == ("plain,failures\nplain,fly\nplain,flights\n", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_completion_script_is_accepted_by_its_shell(shell, tmp_path):
    script = run("completion", shell)
    assert (script.returncode, script.stderr) == (0, "")
    assert "_SWARM_COMPLETE" in script.stdout
    if shutil.which(shell):
        path = tmp_path / "script"
        path.write_text(script.stdout)
        subprocess.run([shell, "-n", str(path)], check=True)


def test_the_emulators_help_looks_like_the_others():
    printed = subprocess.run(
        [PROGRAM, "sitl", "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert printed.startswith("Usage: swarm sitl [OPTIONS]\n")
    assert "Example: swarm sitl -n 3 --autopilot ardupilot" in printed
