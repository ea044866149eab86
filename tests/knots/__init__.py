"""Tests of swarm.knots."""
