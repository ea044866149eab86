"""Gauss codes as text, and equality of their diagrams."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm.knots.gauss import KnotError, SignedGauss, parse_gauss, same_code
from tests.knots.curves import random_diagram

TREFOIL = ((1, False), (2, True), (3, False), (1, True), (2, False), (3, True))


@pytest.mark.parametrize(
    "text",
    [
        "1- 2+ 3- 1+ 2- 3+",
        "1-2+3-1+2-3+",
        "1−, 2+, 3−, 1+, 2−, 3+",
        "-1, 2, -3, 1, -2, 3",
        "[-1, 2, -3, 1, -2, 3]",
        "U1+ O2+ U3+ O1+ U2+ O3+",
        "u1+o2+u3+o1+u2+o3+",
    ],
)
def test_every_notation_of_the_overhand(text: str) -> None:
    assert parse_gauss(text).passes == TREFOIL


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", 'the Gauss code is empty; a cable without a knot is named "unknot"'),
        ("1- 2+ 3- 1+ 2-", "crossing 3 is passed once (expected twice)"),
        ("1- 2+ 1- 2-", "crossing 1 is passed twice under"),
        ("1+ 1- 1+ 1-", "crossing 1 is passed 4 times (expected twice)"),
        (
            "1+ 2+ 1+ 3-",
            "crossing 1 is passed twice over; crossing 2 is passed once (expected twice); "
            "crossing 3 is passed once (expected twice)",
        ),
        (
            "1- 2x 3-",
            'Gauss code, entry 2: expected a crossing and a mark such as "3+", got "2x"',
        ),
        ("U1+ O2 U3+", 'Gauss code, entry 2: expected such as "O3+", got "O2"'),
        ("1, 2, 0", 'Gauss code, entry 3: expected such as "-3", got "0"'),
        (
            "1- 2+ | 1+ 2-",
            "the Gauss code has 2 components: it is a link; one cable is one",
        ),
        ("U1+ O1-", "a crossing has the same sign at both of its passes"),
    ],
)
def test_invalid_codes_are_reported(text: str, message: str) -> None:
    with pytest.raises(KnotError) as caught:
        parse_gauss(text)
    assert str(caught.value) == message


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(4, 14), start=st.integers(0, 100))
def test_a_code_is_the_same_from_any_start_and_under_any_names(
    seed: int, count: int, start: int
) -> None:
    code = random_diagram(seed, count).code
    turned = code.rotated(start % max(1, len(code.passes)))
    renamed = SignedGauss.of(((99 - k, over, sign) for k, over, sign in turned.passes), closed=True)
    assert same_code(code, renamed)
    assert same_code(code, renamed.reversed(), reverse=True)
    assert parse_gauss(code.signed_text()).signed() == code if code.passes else True


def test_codes_differ_by_mirror_image_direction_and_ends() -> None:
    right = parse_gauss("U1+ O2+ U3+ O1+ U2+ O3+").signed()
    assert right is not None
    assert not same_code(right, right.mirrored())
    assert not same_code(right, SignedGauss(right.passes, closed=False))
    open_code = SignedGauss.of(
        [(1, True, 1), (2, False, 1), (1, False, 1), (2, True, 1)], closed=False
    )
    other_start = SignedGauss.of(open_code.passes[1:] + open_code.passes[:1], closed=False)
    assert not same_code(open_code, other_start)
    one_way = SignedGauss.of(
        [(1, True, 1), (2, True, 1), (2, False, 1), (1, False, 1)], closed=False
    )
    assert not same_code(one_way, one_way.reversed())
    assert same_code(one_way, one_way.reversed(), reverse=True)
