"""dolfinmpm: an unfitted material point method on FEniCSx."""

from dolfinmpm import materials, study
from dolfinmpm.boundary import fixed, prescribed, rollers
from dolfinmpm.fill import fill
from dolfinmpm.grid import cell_size
from dolfinmpm.info import info
from dolfinmpm.io import ParaView, figure, plot
from dolfinmpm.kinematics import momentum
from dolfinmpm.points import MaterialPoints
from dolfinmpm.progress import steps
from dolfinmpm.shapes import Ball, Box, Disc, Polygon, Shape, TurnedBox, Where
from dolfinmpm.solve import QuasiStatic
from dolfinmpm.space import Space
from dolfinmpm.stabilise import Stabilisation, ghost, soft

__version__ = "0.1.0"

__all__ = [
    "Ball",
    "Box",
    "Disc",
    "MaterialPoints",
    "ParaView",
    "Polygon",
    "QuasiStatic",
    "Shape",
    "Space",
    "Stabilisation",
    "TurnedBox",
    "Where",
    "cell_size",
    "figure",
    "fill",
    "fixed",
    "ghost",
    "info",
    "materials",
    "momentum",
    "plot",
    "prescribed",
    "rollers",
    "soft",
    "steps",
    "study",
]
