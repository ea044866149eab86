"""Pictures: Rerun, terminal, plots. Nothing here can stop a flight."""
