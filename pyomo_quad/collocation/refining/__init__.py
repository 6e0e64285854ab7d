"""Error estimation and mesh refinement."""
