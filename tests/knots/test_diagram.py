"""Codes → diagrams and back; the codes of plane curves."""

import itertools

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from swarm.knots.diagram import (
    Diagram,
    diagram_of_pd,
    diagrams_of_dt,
    diagrams_of_gauss,
    faces,
    realisations,
)
from swarm.knots.gauss import KnotError, SignedGauss, same_code
from swarm.knots.invariants import identify_diagram, jones_polynomial, summands
from tests.knots.curves import of_knotinfo, random_diagram

PAPER = {
    "3_1": "1- 2+ 3- 1+ 2- 3+",
    "4_1": "1- 2+ 3- 4+ 2- 1+ 4- 3+",
    "8_18": "1+ 2- 3+ 4- 5+ 6- 2+ 7- 4+ 8- 6+ 1- 7+ 3- 8+ 5-",
}
"""The three codes that the paper prints."""


@pytest.mark.parametrize("name", PAPER)
def test_the_papers_codes_mean_a_mirror_pair_of_its_knots(name: str) -> None:
    one, two = diagrams_of_gauss(PAPER[name])
    assert same_code(one.code, two.mirrored().code)
    assert one.code.text() == PAPER[name]
    assert identify_diagram(one).name == identify_diagram(two).name == name


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 14))
def test_a_curves_own_signs_are_among_the_realisations(seed: int, count: int) -> None:
    diagram = random_diagram(seed, count)
    assume(len(summands(diagram)) <= 6)
    found = realisations([(k, over) for k, over, _ in diagram.code.passes])
    assert diagram in found
    assert len(set(found)) == len(found) == 2 ** len(summands(diagram))
    assert {one.mirrored() for one in found} == set(found)


@settings(deadline=None)
@given(word=st.permutations([1, 1, 2, 2, 3, 3, 4, 4, 5, 5]))
def test_realisable_means_that_some_signs_lie_in_the_plane(word: list[int]) -> None:
    seen: set[int] = set()
    passes = []
    for label in word:
        passes.append((label, label in seen))
        seen.add(label)
    planar = set()
    for signs in itertools.product((1, -1), repeat=5):
        code = SignedGauss.of(((k, over, signs[k - 1]) for k, over in passes), closed=True)
        if len(faces(code)) == 7:
            planar.add(code)
    try:
        found = {diagram.code for diagram in realisations(passes)}
    except KnotError:
        found = set()
    assert found == planar


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "1+ 2- 1- 2+",
            "no curve in the plane has this Gauss code: between the two passes of crossing 1 "
            "there is an odd number of passes",
        ),
        (
            "1+ 2- 3+ 4- 5+ 3- 4+ 1- 2+ 5-",
            "no curve in the plane has this Gauss code",
        ),
        ("U1+ O2+ U3+ O1+ U2- O3+", "a crossing has the same sign at both of its passes"),
        ("U1- O2+ U3+ O1- U2+ O3+", "no curve in the plane has this signed Gauss code"),
    ],
)
def test_codes_of_no_plane_curve(text: str, message: str) -> None:
    with pytest.raises(KnotError) as caught:
        diagrams_of_gauss(text)
    assert str(caught.value) == message


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 16))
def test_pd_and_back(seed: int, count: int) -> None:
    diagram = random_diagram(seed, count)
    if diagram.crossings:
        again = diagram_of_pd(diagram.pd())
        assert same_code(again.code, diagram.code)
        # Edges may have any numbers, and a crossing may be entered at either under edge.
        renamed = [[100 - 3 * edge for edge in (*row[2:], *row[:2])] for row in diagram.pd()]
        assert same_code(diagram_of_pd(renamed).code, diagram.code, reverse=True)


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 12))
@example(seed=10, count=11)  # each of seven crossings is a part of its own: 128 diagrams
def test_dt_and_back(seed: int, count: int) -> None:
    diagram = random_diagram(seed, count)
    if not 0 < diagram.crossings < 8:
        return
    if diagram.crossings == len(summands(diagram)) == 7:
        with pytest.raises(KnotError, match="consists of 7 parts, each of either chirality"):
            diagrams_of_dt(diagram.dt())
        return
    found = [again.code for again in diagrams_of_dt(diagram.dt())]
    # A DT code does not say which side is up either: seen from behind, it is the same knot.
    behind = SignedGauss(
        tuple((k, not over, sign) for k, over, sign in diagram.code.passes), closed=True
    )
    assert any(same_code(code, one) for code in found for one in (diagram.code, behind))


@pytest.mark.parametrize(
    ("dt", "message"),
    [
        ((), 'the DT code is empty; a cable without a knot is named "unknot"'),
        ((4, 5, 2), "DT code: entry 2: expected an even number, got 5"),
        ((4, 4, 2), "DT code: expected each of 2, 4, …, 6 once (with either sign)"),
    ],
)
def test_wrong_dt_codes(dt: tuple[int, ...], message: str) -> None:
    with pytest.raises(KnotError) as caught:
        diagrams_of_dt(dt)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("pd", "message"),
    [
        ([], 'the PD code is empty; a cable without a knot is named "unknot"'),
        ([[1, 2, 3]], "PD code, crossing 1: expected 4 edges, got 3"),
        (
            [[1, 5, 2, 4], [3, 1, 4, 6], [5, 3, 6, 7]],
            "PD code: edge 2 occurs 1 times; edge 7 occurs 1 times (expected twice each)",
        ),
        (
            [[4, 1, 3, 2], [2, 3, 1, 4]],
            "the PD code is that of a link; one cable has one component",
        ),
    ],
)
def test_wrong_pd_codes(pd: list[list[int]], message: str) -> None:
    with pytest.raises(KnotError) as caught:
        diagram_of_pd(pd)
    assert str(caught.value) == message


@pytest.mark.parametrize("name", ["3_1", "4_1", "8_19", "9_40", "10_132", "10_165"])
def test_knotinfos_pd_and_dt_codes_agree(name: str) -> None:
    of_pd = jones_polynomial(diagram_of_pd(of_knotinfo(name, "pd_notation")))
    of_dt = [jones_polynomial(one) for one in diagrams_of_dt(of_knotinfo(name, "dt_notation"))]  # type: ignore[arg-type]
    assert of_pd in of_dt


def test_a_diagram_is_closed() -> None:
    with pytest.raises(KnotError, match="a diagram needs a closed code"):
        Diagram(SignedGauss((), closed=False))
