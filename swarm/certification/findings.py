"""One result of one check of a plan or of a team; and one message for many vehicles."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """A result of a check.

    ``at_time`` is mission time in seconds, ``where`` a place in ENU metres; None where not
    applicable.
    """

    severity: Severity
    check: str
    message: str
    at_time: float | None = None
    where: tuple[float, float, float] | None = None


_SYSTEM = re.compile(r"system (\d+): ")


def numbers(listed: Sequence[int]) -> str:
    """Return numbers as text, runs as ranges: ``1–3, 7``."""
    runs: list[list[int]] = []
    for number in listed:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(f"{r[0]}–{r[-1]}" if len(r) > 1 else str(r[0]) for r in runs)


def in_common(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings; equal ones on many systems are one."""
    merged: dict[Finding, list[int]] = {}
    for finding in findings:
        named = _SYSTEM.match(finding.message)
        words = finding.message[named.end() :] if named else finding.message
        systems = merged.setdefault(replace(finding, message=words), [])
        if named:
            systems.append(int(named[1]))
    return [
        replace(finding, message=of_systems(systems) + finding.message)
        for finding, systems in merged.items()
    ]


def by_system(findings: Iterable[Finding]) -> dict[int, str]:
    """Return what findings say of each system, in words; of many of one check the first."""
    said: dict[int, dict[str, list[str]]] = {}
    for finding in findings:
        if named := _SYSTEM.match(finding.message):
            checks = said.setdefault(int(named[1]), {})
            checks.setdefault(finding.check, []).append(finding.message[named.end() :])
    return {
        system: "; ".join(
            words[0] + (f" (and {len(words) - 1} more)" if words[1:] else "")
            for words in checks.values()
        )
        for system, checks in said.items()
    }


def of_systems(systems: Sequence[int]) -> str:
    """Return the prefix of a message: ``systems 1–3, 7: ``; "" without systems."""
    if not systems:
        return ""
    return f"system{'s' if len(systems) > 1 else ''} {numbers(systems)}: "
