"""``python -m swarm_knot_table``: write the table of knots."""

from swarm_knot_table.tabulation import main

main()
