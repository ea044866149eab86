"""Failures outside the links: files, processes and sockets, with the tests that cause them."""

from typing import NamedTuple


class SystemFailureCase(NamedTuple):
    """A failure of files, processes or sockets, the required behaviour, and its tests."""

    name: str
    expected: str
    tests: tuple[str, ...]


SYSTEM_FAILURE_CASES: tuple[SystemFailureCase, ...] = (
    SystemFailureCase(
        "disk full",
        "reported once; the flight continues, the record keeps the data written before",
        (
            "tests/ground/test_fly.py::"
            "test_a_disk_that_becomes_full_in_flight_damages_the_record_only",
            "tests/ground/test_record.py::test_a_full_disk_damages_the_record_only",
        ),
    ),
    SystemFailureCase(
        "viewer hangs",
        "no setpoint is late; the viewer loses the data that it does not read",
        (
            "tests/ground/test_flight_process.py::test_a_slow_caller_does_not_delay_the_flight",
            "tests/view/test_rerun_log.py::test_a_stalled_sink_delays_neither_flight_nor_other_sinks",
            "tests/view/test_rerun_log.py::test_a_killed_sink_delays_neither_flight_nor_other_sinks",
        ),
    ),
    SystemFailureCase(
        "killed in flight and resumed",
        "the record lacks one second at most; the next process finds the team and holds it",
        (
            "tests/ground/test_fly.py::"
            "test_after_sigkill_only_the_last_second_of_the_record_is_missing",
            "tests/flight/test_resuming.py",
            "tests/ground/test_resume.py",
        ),
    ),
    SystemFailureCase(
        "foreign packets on the links",
        "spoofed, replayed and fuzzed packets and floods change no setpoint",
        ("tests/flight/test_security.py", "tests/ground/test_flood.py"),
    ),
)
