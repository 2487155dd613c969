"""Grasp programs: energy terms, the batched search, the nonlinear programs, and the solvers."""
