"""From a Pyomo.DAE model to templates in CasADi symbols."""
