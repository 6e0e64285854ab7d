"""Tables, figures and documents of a plan or a run; the only floor that draws."""
