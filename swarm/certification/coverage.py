"""Which clearances certificate, lost setpoints and monitor compare: one table, for the pages too.

The certificate covers the planned motion with every tracking error; the certificate of lost
setpoints the states after a loss in the fold; the live monitor the measured positions and those
1.5 s ahead.
"""

from typing import NamedTuple


class Covered(NamedTuple):
    """Objects, what is required of them, and when certificate, lost setpoints and monitor compare
    them; the ``checks`` are names of the certificate's."""

    objects: str
    required: str
    checks: tuple[str, ...]
    certificate: str
    lost: str
    monitor: str


COVERAGE = (
    Covered(
        "two segments that share no vehicle, surface to surface", "`clearance.cable`",
        ("cable clearance",), "aloft, landing", "in the fold", "aloft",
    ),
    Covered(
        "two segments that share a vehicle, beyond the exempt length", "`clearance.cable`",
        ("neighbouring segments",), "aloft, landing", "in the fold", "aloft",
    ),
    Covered(
        "a segment and the floor", "`clearance.floor`", ("floor",), "aloft", "in the fold", "aloft"
    ),
    Covered(
        "two vehicles, centre to centre",
        "`clearance.vehicle` horizontally **or** `clearance.downwash` vertically",
        ("vehicle clearance",), "always", "in the fold", "unless cable lies on the floor",
    ),
    Covered(
        "a vehicle and the segments of others", "`clearance.vehicle_cable`",
        ("vehicle-cable clearance",), "aloft, landing", "in the fold", "aloft",
    ),
    Covered(
        "a vehicle and its own segments", "outside its rotor disc", ("rotor disc",),
        "aloft, landing", "in the fold", "aloft",
    ),
    Covered(
        "chord and length", "the inequality above", ("taut",), "lifted, aloft, landing",
        "in the fold", "aloft",
    ),
    Covered(
        "a vehicle and the fence", "inside", ("fence",), "always", "in the fold",
        "unless cable lies on the floor",
    ),
    Covered("a segment and the fence", "inside", ("fence",), "held", "in the fold", "aloft"),
    Covered(
        "a vehicle and the ceiling", "below", ("ceiling",), "always", "in the fold",
        "unless cable lies on the floor",
    ),
    Covered("a grip point and the floor", "above", ("ground",), "always", "no", "no"),
    Covered(
        "cable on the floor: reach of segments and vehicles, lying, in a line, beside rotors",
        "below, *cable on the floor*",
        (
            "reach on the floor", "over-stretched on the floor", "lying", "drawn out",
            "beside rotors",
        ),
        "on the floor, lifted", "no", "no",
    ),
    Covered(
        "the shape of the team in a common descent", "unchanged", ("straight down",), "landing",
        "no", "no",
    ),
    Covered(
        "speed; acceleration", "limits; braking along the path is kept in reserve",
        ("speed", "acceleration"), "always", "no", "no",
    ),
)  # fmt: skip


def coverage_table() -> str:
    """Return the table as Markdown."""
    head = "| objects | required | certificate | lost setpoints | live monitor |"
    rows = [head, "|---|---|---|---|---|"]
    rows += [
        f"| {row.objects} | {row.required} | {row.certificate} | {row.lost} | {row.monitor} |"
        for row in COVERAGE
    ]
    return "\n".join(rows)
