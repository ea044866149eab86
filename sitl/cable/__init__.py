"""The cable: statics of its spans, falling and loose parts, distance to rotors."""
