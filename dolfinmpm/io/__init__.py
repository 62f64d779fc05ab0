"""Output of a computation: ParaView series and pictures."""

from dolfinmpm.io.figures import figure
from dolfinmpm.io.paraview import ParaView
from dolfinmpm.io.plots import plot

__all__ = ["ParaView", "figure", "plot"]
