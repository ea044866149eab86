"""The stages of a flight: what is done at every tick of each, and how one follows another."""
