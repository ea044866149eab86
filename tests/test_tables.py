"""Tables that people hand in: read as they were written, or refused with line and column."""

import codecs
import csv
import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.certification.motion_file import read_lengths, read_motion
from swarm.errors import InputError
from swarm.files import decoded
from swarm.knots.curve import parse_curve

MOTION = "time,vehicle,x,y,z,vx,vy,vz,ax,ay,az,phase"


def lengths(data: bytes) -> list[float]:
    return read_lengths(decoded(data, "l.csv"), "l.csv").tolist()


def refusal(read, text: str) -> str:
    with pytest.raises(InputError) as error:
        read(text, "l.csv")
    return str(error.value)


def outcome(read, *arguments):
    try:
        return read(*arguments)
    except InputError as error:
        return error


WRITTEN = st.decimals(min_value="0.001", max_value=9999, places=3).map(
    lambda number: f"{number.normalize():f}"
)


@st.composite
def sheets(draw):
    """Return a cable list as a spreadsheet program may write it, and its lengths."""
    values = draw(st.lists(WRITTEN, min_size=1, max_size=8))
    separator, mark = draw(st.sampled_from(",;\t")), draw(st.sampled_from(".,"))
    names = draw(st.sampled_from([["length"], ["n", "length (m)"], ["Length", "note"], []]))
    notes = draw(st.lists(st.sampled_from(["5", "5,5", "", "good; new", 'a "b"']), min_size=8))
    rows = [names] if names else []
    for number, (value, note) in enumerate(zip(values, notes, strict=False)):
        cell = {"length": value, "length (m)": value, "Length": value, "n": str(number + 1)}
        rows.append([cell.get(name, note).replace(".", mark) for name in names or ["length"]])
    end, trailing = draw(st.sampled_from(["\n", "\r\n", "\r"])), draw(st.booleans())
    text = io.StringIO(newline="")
    if draw(st.booleans()):
        text.write(f"sep={separator}{end}")
    csv.writer(
        text, delimiter=separator, lineterminator=end,
        quoting=draw(st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL])),
    ).writerows([row + [""] * trailing for row in rows])  # fmt: skip
    blank = draw(st.sampled_from(["", end, f"{end}{end}"]))
    bom = draw(st.sampled_from([b"", codecs.BOM_UTF8]))
    return bom + (text.getvalue() + blank).encode(), [float(value) for value in values]


@given(sheets())
def test_a_cable_list_is_read_as_it_was_written_or_refused(sheet):
    data, written = sheet
    found = outcome(lengths, data)
    # With a decimal comma, three digits behind it may be thousands; everything else is read.
    doubtful = re.search("with one reading|decimal comma", str(found))
    assert (doubtful and b"," in data) or found == written


@given(st.text(alphabet='0145.,;\t "\r\n-e#xlength=sp٣４\ufeff\0', max_size=40))
def test_any_text_is_read_with_finite_lengths_or_refused_in_words(text):
    for read in (read_lengths, parse_curve, read_motion):
        found = outcome(read, text, "l.csv")
        if isinstance(found, InputError):
            assert all(str(problem).startswith("l.csv") for problem in found.problems)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "4,5\n4,6\n",
            "l.csv: line 1, column 2: expected one column of lengths, or a heading with length, "
            "got 2 columns; a decimal comma needs semicolons or tabs between columns, or quotes",
        ),
        (
            "length\n4,5\n",
            "l.csv: line 2: expected as many columns as line 1 has (1), got 2; decimal commas need "
            "semicolons or tabs between columns",
        ),
        (
            "4,500;\n4,300;\n",
            "l.csv: line 1, column 1: expected a number with one reading, got '4,500': 4.500 or "
            "4500?",
        ),
        (
            "4,5;\n4.6;\n",
            "l.csv: line 2, column 1: expected decimal commas as in line 1, got '4.6'",
        ),
        (
            "length,length\n4,5\n",
            "l.csv: line 1, column 2: expected each column once, got 'length' again",
        ),
        ("length (mm)\n4500\n", "l.csv: line 1, column 1: length: expected m, got mm"),
        ("length_mm\n4500\n", "l.csv: line 1: expected the columns length, got 'length_mm'"),
        (
            ",length\n1,4.5\n",
            "l.csv: line 2, column 1: expected nothing in a column without a name, got '1'",
        ),
        ("4.5\n٤\n", "l.csv: line 2, column 1: expected a number, got '٤'"),
        ("4.5\n1_000\n", "l.csv: line 2, column 1: expected a number, got '1_000'"),
        ("4.5\n1e400\n", "l.csv: line 2, column 1: expected a finite number, got '1e400'"),
        ("4.5\nlength\n", "l.csv: line 2, column 1: expected a number, got 'length'"),
        ("4.5\n4\0\n", "l.csv: line 2, character 2: expected text, got the control character 0"),
        ('4.5\n"4.5\n', "l.csv: line 2: not a table: unexpected end of data"),
        (
            '{"segments": [4.0], "segments": [9.0]}',
            "l.csv: not valid JSON: the key 'segments' twice in an object",
        ),
        (
            '{"segments": [4.0], "cable": {"segments": [9.0]}}',
            "l.csv: expected segments or cable, got both",
        ),
        ("[" * 100_000, "l.csv: not valid JSON: nested more than 64 deep"),
        ("[4.0, NaN]", "l.csv: not valid JSON: expected a finite number, got NaN"),
        ("[4.0, 1e400]", "l.csv: not valid JSON: expected a finite number, got 1e400"),
    ],
)
def test_a_cable_list_with_two_readings_or_none_is_refused(text, message):
    assert refusal(read_lengths, text) == message


def test_text_in_two_byte_units_is_named():
    with pytest.raises(InputError, match="expected UTF-8 text, got UTF-16: save the file as UTF-8"):
        lengths("4.5\n".encode("utf-16"))


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_motions_are_read_in_every_notation(separator, mark):
    rows = [
        [f"{time}{mark}0", str(vehicle), f"{2 * vehicle}{mark}25", *8 * ["0"], "fold"]
        for time in (0, 1)
        for vehicle in (1, 2)
    ]
    text = io.StringIO(newline="")
    csv.writer(text, delimiter=separator).writerows([MOTION.split(","), *rows])
    motion = read_motion(text.getvalue(), "m.csv")
    assert motion.states[:, :, 0].tolist() == [[2.25, 4.25]] * 2
    assert motion.time.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("factor", [1, 10**3, 10**6, 10**9])
def test_stamps_since_1970_are_no_times_of_a_flight(factor):
    stamp = 1_700_000_000 * factor
    unit = {1: "seconds", 10**3: "milliseconds", 10**6: "microseconds"}.get(factor, "nanoseconds")
    said = refusal(read_motion, f"{MOTION}\n{stamp},1,{'0,' * 9}fold\n")
    assert said == (
        f"l.csv: line 2, column 1: time: expected seconds from the start, got {stamp}: a Unix stamp "
        f"in {unit}"
    )


def test_a_curve_may_have_an_index_before_its_points():
    text = "1 0 0 0\n2 1 0 0\n3 1 1 0.5\n"
    assert parse_curve(text, "c.xyz")[0].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0.5]]
    assert refusal(parse_curve, text.replace("3 1", "4 1")) == (
        "l.csv: line 3, column 1: expected the index 3, since there are four columns without a "
        "heading, got '4'"
    )
