"""What was flown: the knot that the flown positions imply, and the clearances that were kept."""

from swarm.flight.trace import Trace as Trace
