"""Solvers: each takes a weak form through time or load."""

from dolfinmpm.solve.quasistatic import QuasiStatic, StepRecord

__all__ = ["QuasiStatic", "StepRecord"]
