"""Pages, plots, the printed sheet and terminal texts about plans and flights."""
