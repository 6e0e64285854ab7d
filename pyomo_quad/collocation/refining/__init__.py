"""The error of a solution, and the mesh that makes it small enough."""
