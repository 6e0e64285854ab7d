"""The nonlinear program: sparsity, bounds, transcription, derivatives, and Ipopt."""
