"""Error estimation and mesh refinement for solutions by collocation."""
