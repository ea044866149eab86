"""ArduCopter 4.6: modes, commands, failsafes, setpoints."""
