"""PX4 1.16: modes, commands, failsafes, setpoints, telemetry."""
