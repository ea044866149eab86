"""Statics of a hanging cable: catenaries, chains of them, and distances between strands."""
