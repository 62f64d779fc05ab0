"""Output of a computation: ParaView series, pictures and films."""

from dolfinmpm.io.animation import Film, animate
from dolfinmpm.io.figures import figure
from dolfinmpm.io.paraview import ParaView
from dolfinmpm.io.plots import plot

__all__ = ["Film", "ParaView", "animate", "figure", "plot"]
