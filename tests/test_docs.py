"""The documentation: generated pages are up to date, links resolve, shown commands exist."""

import importlib
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from ruamel.yaml import YAML

import swarm
from sitl.__main__ import command as emulator
from swarm.cli.main import COMMANDS, cli
from tests import docs_reference

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"
PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")),
        *(ROOT / "docs").rglob("*.md"),
        ROOT / "missions" / "paper" / "README.md",
    ]
)
WRITTEN = [page for page in PAGES if page.parent != REFERENCE]
NOT_PLAIN = (
    r"whoever|whom|whomever|anybody|somebody|nobody|everybody|wherever|heedless|thereof|hence"
)


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def fenced(page: Path, language: str) -> Iterator[str]:
    yield from re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.M | re.S)


def anchors(page: Path) -> set[str]:
    """Names of a page's headings as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    titles = re.findall(r"^#+ +(.+)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_generated_pages_are_what_the_program_says():
    stored = {page.name: page.read_text() for page in REFERENCE.iterdir()}
    assert stored == docs_reference.pages(), "run: python -m tests.docs_reference"


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_relative_links_resolve(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    missing = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"https?:", target):
            continue
        path, _, anchor = target.partition("#")
        aim = (page.parent / path).resolve() if path else page
        if not aim.exists() or (anchor and anchor not in anchors(aim)):
            missing.append(target)
    assert missing == []


def shown(page: Path) -> Iterator[list[str]]:
    """Every ``swarm`` command of a page's shell blocks and inline code, in words."""
    text = page.read_text()
    inline = re.findall(r"(?<!`)`(swarm [^`\n]+)`(?!`)", text)
    blocks = (block.replace("\\\n", " ") for block in fenced(page, "sh"))
    for line in [line for block in blocks for line in block.splitlines()] + inline:
        for part in re.split(r"&&|\|\||;", line):
            words = shlex.split(part, comments=True)
            if words and Path(words[0]).name == "swarm":
                yield words[1:]


def options_of(command: str) -> set[str]:
    found = emulator if command == "sitl" else cli.get_command(click.Context(cli), command)
    assert found is not None
    return {"--help", *(name for one in found.params for name in one.opts)}


@pytest.mark.parametrize("page", WRITTEN, ids=named)
def test_commands_that_are_shown_exist(page):
    wrong = []
    for words in shown(page):
        command, *rest = words
        if command.startswith("-"):
            continue
        given = {word.partition("=")[0] for word in rest if re.match(r"--?[a-zA-Z]", word)}
        if command not in COMMANDS or not given <= options_of(command):
            wrong.append(" ".join(words))
    assert wrong == []


def missing_names(page: Path) -> Iterator[str]:
    """Paths, and dotted names of the two packages, in inline code, that do not exist."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    for name in re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text):
        if re.fullmatch(r"(swarm|sitl|tests|missions|docs)/[\w./-]*", name):
            if not (ROOT / name).exists():
                yield name
        elif re.fullmatch(r"(swarm|sitl|tests)(\.\w+)+", name) and not is_importable(name):
            yield name


def is_importable(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of the longest module in it."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


@pytest.mark.parametrize("page", WRITTEN, ids=named)
def test_names_of_the_code_that_are_mentioned_exist(page):
    assert list(missing_names(page)) == []


@pytest.mark.parametrize("package", ["swarm", "sitl"])
def test_names_that_docstrings_refer_to_exist(package):
    wrong = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in re.findall(r":[a-z]+:`~?((?:swarm|sitl)\.[\w.]+)`", path.read_text())
        if not is_importable(name)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    ("name", "exists"),
    [
        ("swarm.planner.plan", True),
        ("swarm.planner.PlanningResult.certified", True),
        ("swarm.planner.unplan", False),
        ("swarm.no_module", False),
    ],
)
def test_a_name_that_does_not_exist_is_found(name, exists):
    assert is_importable(name) == exists


def test_every_command_is_shown_somewhere():
    assert {words[0] for page in WRITTEN for words in shown(page)} >= set(COMMANDS)


@pytest.mark.parametrize("page", WRITTEN, ids=named)
def test_words_are_plain(page):
    assert re.findall(rf"\b({NOT_PLAIN})\b", page.read_text(), re.I) == []


@pytest.mark.parametrize(("package", "place"), [("swarm", 0), ("sitl", 1)])
def test_the_tables_of_layers_are_the_import_contracts(package, place):
    described = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contract = described["tool"]["importlinter"]["contracts"][place]
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(rf"^\| (`{package}\.[^|]*) \|", page, re.M)
    assert contract["containers"] == [package]
    assert [set(re.findall(rf"`{package}\.(\w+)`", row)) for row in rows] == [
        set(layer.split(" | ")) for layer in contract["layers"]
    ]


def test_the_ways_through_a_flight_name_its_files_and_functions():
    page = (ROOT / "docs" / "architecture.md").read_text()
    section = page.partition("## The flight, tick by tick")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]*\.py`[^|]*) \| (.*) \|$", section, re.M)
    assert len(rows) > 14
    folder = ROOT / "swarm" / "flight"
    for files, what in rows:
        named = re.findall(r"`([\w/]+\.py)`", files + what)
        text = "".join((folder / file).read_text() for file in named)
        for name in re.findall(r"`([A-Za-z_]\w*)[(`]", what):
            assert re.search(rf"\b{name}\b", text), f"{name} is not in {named}"


def test_the_citation_names_this_version_and_the_paper():
    cited = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert cited["version"] == swarm.__version__
    (paper,) = cited["references"]
    assert paper["title"] == "Folding Knots Using a Team of Aerial Robots"
    assert [author["family-names"] for author in paper["authors"]] == ["D'Antonio", "Saldaña"]


def test_continuous_integration_runs_every_python_that_is_named():
    workflow = YAML(typ="safe").load((ROOT / ".github" / "workflows" / "test.yml").read_text())
    job = workflow["jobs"]["test"]
    described = (ROOT / "pyproject.toml").read_text()
    named_there = re.findall(r"Python :: (3\.\d+)\"", described)
    assert job["strategy"]["matrix"]["python"] == named_there
    assert {"run": ".ci/run"} in job["steps"]


def test_hooks_before_a_commit_run_the_tools_of_the_house_rules():
    hooks = YAML(typ="safe").load((ROOT / ".pre-commit-config.yaml").read_text())
    entries = [hook["entry"] for repo in hooks["repos"] for hook in repo["hooks"]]
    rules = (ROOT / "tests" / "test_house.py").read_text()
    for entry in entries:
        assert ", ".join(f'"{word}"' for word in entry.split()) in rules
    assert len(entries) == 4
