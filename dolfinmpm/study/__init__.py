"""Studies: condition numbers, critical time steps, sweeps, convergence; their tables and plots."""

from dolfinmpm.io.tables import (
    draw_convergence,
    draw_sweep,
    plot_convergence,
    plot_sweep,
    read_table,
    write_table,
)
from dolfinmpm.study.condition import Conditioning, conditioning
from dolfinmpm.study.spectra import condition_number, critical_step, rigid_modes
from dolfinmpm.study.sweeps import convergence, observed_orders, overall_order, sweep, worst

__all__ = [
    "Conditioning",
    "condition_number",
    "conditioning",
    "convergence",
    "critical_step",
    "draw_convergence",
    "draw_sweep",
    "observed_orders",
    "overall_order",
    "plot_convergence",
    "plot_sweep",
    "read_table",
    "rigid_modes",
    "sweep",
    "worst",
    "write_table",
]
