"""What leaves a computation: ParaView series and pictures."""

from dolfinmpm.io.paraview import ParaView
from dolfinmpm.io.plots import figure, plot

__all__ = ["ParaView", "figure", "plot"]
