"""The documentation: generated pages are up to date."""

from pathlib import Path

from tests import docs_reference

REFERENCE = Path(__file__).parents[1] / "docs" / "reference"


def test_generated_pages_are_what_the_program_says():
    stored = {page.name: page.read_text() for page in REFERENCE.iterdir()}
    assert stored == docs_reference.pages(), "run: python -m tests.docs_reference"
