"""Studies: condition numbers, critical steps, sweeps, convergence, safety; tables and plots."""

from dolfinmpm.io.studyplots import (
    draw_convergence,
    draw_reduction,
    draw_sweep,
)
from dolfinmpm.io.tables import read_table, write_table
from dolfinmpm.solve.spectra import condition_number, critical_step, rigid_modes
from dolfinmpm.study.calibration import Calibration, calibrate
from dolfinmpm.study.condition import Conditioning, conditioning
from dolfinmpm.study.derivatives import Derivatives, differentiate
from dolfinmpm.study.distributions import LogNormal, Normal
from dolfinmpm.study.elementtest import element_test
from dolfinmpm.study.limitstate import LimitState
from dolfinmpm.study.randomfields import RandomField
from dolfinmpm.study.reduction import factor_of_safety, reduced_strength
from dolfinmpm.study.reliability import Reliability, reliability
from dolfinmpm.study.samples import MonteCarlo, monte_carlo
from dolfinmpm.study.scenerun import Run
from dolfinmpm.study.sweeps import convergence, observed_orders, overall_order, sweep, worst
from dolfinmpm.study.trial import FactorOfSafety, Trial

__all__ = [
    "Calibration",
    "Conditioning",
    "Derivatives",
    "FactorOfSafety",
    "LimitState",
    "LogNormal",
    "MonteCarlo",
    "Normal",
    "RandomField",
    "Reliability",
    "Run",
    "Trial",
    "calibrate",
    "condition_number",
    "conditioning",
    "convergence",
    "critical_step",
    "differentiate",
    "draw_convergence",
    "draw_reduction",
    "draw_sweep",
    "element_test",
    "factor_of_safety",
    "monte_carlo",
    "observed_orders",
    "overall_order",
    "read_table",
    "reduced_strength",
    "reliability",
    "rigid_modes",
    "sweep",
    "worst",
    "write_table",
]
