"""Flights in virtual time: one, many with drawn conditions, and with faults injected."""
