"""Inspection of vehicles before they are armed: survey, audit, parameters, logs."""
