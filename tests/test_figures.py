"""Figures and output in the documentation are those that the program prints."""

import json
import math
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.command import run
from tests.golden.environment import environment
from tests.golden.plans import RELATIVE

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GOLDEN = ROOT / "tests" / "golden" / "plans"
NUMBER = re.compile(r"\d+(?:\.\d+)?")
OF_PAIR = re.compile(r"\b(?:segments?|vehicles?|and|at) \d+(?:\.\d+)?$")
UNTIL_NEXT_BLOCK = r"(?:(?!```)[^\n]*\n)*?"


def with_output(page: Path) -> Iterator[tuple[list[str], str]]:
    """Every command but `fly` whose output is the next block of a page, in words, and that output."""
    text = r"```\n((?:(?!```)[^\n]*\n)*)```"
    shown = re.compile(rf"^```sh\nswarm (?!fly)([^\n]+)\n```\n{UNTIL_NEXT_BLOCK}{text}", re.M)
    for command, output in shown.findall(page.read_text()):
        yield shlex.split(command), output


@pytest.fixture(scope="module")
def printed(tmp_path_factory) -> dict[str, str]:
    """What the tutorial's commands print, one after another."""
    outputs = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("tutorial"))
        patch.setenv("COLUMNS", "80")
        Path("missions").symlink_to(ROOT / "missions")
        for (command, *words), _ in with_output(DOCS / "tutorial.md"):
            done = run(command, *words)
            assert done.returncode == 0, done.stderr
            outputs[command] = done.stdout
    return outputs


def one_line(text: str) -> str:
    return " ".join(text.split())


def pattern_of(piece: str) -> str:
    """A regular expression for a piece of output, with a group for each decimal number.

    On another kind of CPU than that of the plan's golden other pairs may be as tight: their
    numbers, moments and shares of the time match whatever they are.
    """
    stored = json.loads((GOLDEN / "missions" / "overhand.json").read_text())
    same, pattern, begin = stored["environment"] == environment(), "", 0
    for number in NUMBER.finditer(piece):
        of_pair = OF_PAIR.search(piece, 0, number.end()) or piece.startswith("%", number.end())
        exact = r"(\d+\.\d+)" if "." in number[0] else number[0]
        pattern += re.escape(piece[begin : number.start()])
        pattern += NUMBER.pattern if of_pair and not same else exact
        begin = number.end()
    return pattern + re.escape(piece[begin:])


@pytest.mark.slow
def test_the_tutorial_shows_what_its_commands_print(printed):
    """Decimal numbers may differ by 5 %, as between processors (tests/golden); line breaks too."""
    shown = {words[0]: output for words, output in with_output(DOCS / "tutorial.md")}
    assert shown.keys() == printed.keys() == {"plan", "dry-run"}
    for command, output in shown.items():
        for piece in map(one_line, output.split("\n…\n")):
            pattern = pattern_of(piece)
            wanted, line = (
                re.fullmatch(pattern, piece),
                re.search(pattern, one_line(printed[command])),
            )
            assert wanted is not None
            assert line, (piece, printed[command])
            expected, found = (
                [float(figure) for figure in match.groups()] for match in (wanted, line)
            )
            assert found == pytest.approx(expected, rel=RELATIVE["duration, s"], abs=0.011)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "words"),
    [
        ("docs/faq.md", r"for `missions/overhand\.yaml` it is ([\d.]+ m/s)"),
        ("docs/tutorial.md", r"The grip points may be up to ([\d.]+ m) away from their setpoints"),
        ("README.md", r"(\d+) for an overhand knot"),
    ],
)
def test_a_figure_in_a_sentence_is_one_of_the_plan(printed, page, words):
    (figure,) = re.findall(words, (ROOT / page).read_text())
    assert re.search(rf"\b{re.escape(figure)}\b", printed["plan"]), printed["plan"]


def rows_of(heading: str) -> list[list[str]]:
    """The rows of the first table below a heading of the results, without its heads."""
    section = (DOCS / "results" / "plans.md").read_text().partition(f"\n## {heading}\n")[2]
    rows = re.findall(r"^\| (.*) \|$", section.partition("\n## ")[0], re.M)
    return [row.split(" | ") for row in rows[1:] if not row.startswith("-")]


def rounded(figures: dict[str, float]) -> list[str]:
    """Return cable, fold, motion and the distance of strands as the tables state them."""
    lengths = [f"{figures[key]:.1f} {key[-1]}" for key in ("cable, m", "fold, s", "duration, s")]
    return [*lengths, down(figures["strand distance, m"], 2, "m")]


def down(value: float | None, decimals: int, unit: str) -> str:
    """Return a figure rounded down; a dash where there is none."""
    if value is None:
        return "–"
    return f"{math.floor(value * 10**decimals) / 10**decimals:.{decimals}f} {unit}"


FILES = {
    "overhand with five": "overhand_five",
    "figure-eight": "figure_eight",
    "8_19": "eight_nineteen",
    "Carrick mat": "carrick_mat",
}


def golden(name: str) -> tuple[str, dict[str, float]]:
    stored = json.loads((GOLDEN / f"{name}.json").read_text())
    return str(stored["vehicles"]), stored["figures"]


def test_the_table_of_missions_has_the_figures_of_their_plans():
    rows = rows_of("Missions")
    assert len(rows) == 11
    for name, _, vehicles, *found in rows:
        count, figures = golden(f"missions/{FILES.get(name, name)}")
        limits = [down(figures.get("e*, m"), 3, "m"), down(figures.get("w*, m/s"), 1, "m/s")]
        assert (vehicles, found) == (count, rounded(figures) + limits), name


def test_the_table_of_knots_has_the_figures_of_their_plans():
    rows = rows_of("Knots by name")
    assert len(rows) == 19
    for name, vehicles, *found in rows:
        count, figures = golden(name)
        assert (vehicles, found) == (count, rounded(figures)), name
