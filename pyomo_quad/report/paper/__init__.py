"""The report on the paper: tables, figures, equations and what follows from them."""
