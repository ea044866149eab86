"""Behaviour of PX4 and ArduPilot: modes, commands, failsafes, telemetry."""
