"""Reading of a Pyomo.DAE model: translation of its declarations to CasADi expressions."""
