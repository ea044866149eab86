"""Unmodified autopilot firmware as the controller of vehicles: the world is its physics."""
