"""``python -m swarm.knot_table``: write the table of knots."""

from swarm.knot_table.tabulation import main

main()
