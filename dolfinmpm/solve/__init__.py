"""Solvers: each takes a weak form through time or load."""

from dolfinmpm.solve.arclength import ArcLength, ArcRecord
from dolfinmpm.solve.groundstart import start_at_rest
from dolfinmpm.solve.initialbalance import equilibrate
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.reactions import reaction
from dolfinmpm.solve.regridding import regrid
from dolfinmpm.solve.step import Step, StepRecord

__all__ = [
    "ArcLength",
    "ArcRecord",
    "QuasiStatic",
    "Step",
    "StepRecord",
    "equilibrate",
    "reaction",
    "regrid",
    "start_at_rest",
]
