"""dolfinmpm: an unfitted material point method on FEniCSx."""

from dolfinmpm import _start as _start  # isort: skip
from dolfinmpm import materials, study
from dolfinmpm.boundary import fixed, prescribed, rollers
from dolfinmpm.fill import fill
from dolfinmpm.grid import cell_size
from dolfinmpm.history import History
from dolfinmpm.info import info
from dolfinmpm.io import ParaView, figure, plot
from dolfinmpm.kinematics import geostatic_stress, momentum, set_stress
from dolfinmpm.points import MaterialPoints
from dolfinmpm.progress import steps
from dolfinmpm.shapes import Ball, Box, Disc, Polygon, Shape, TurnedBox, Where
from dolfinmpm.solve import ArcLength, QuasiStatic
from dolfinmpm.space import Space
from dolfinmpm.stabilise import Stabilisation, ghost, soft
from dolfinmpm.surface import RigidFooting, Surface

__version__ = "0.1.0"

__all__ = [
    "ArcLength",
    "Ball",
    "Box",
    "Disc",
    "History",
    "MaterialPoints",
    "ParaView",
    "Polygon",
    "QuasiStatic",
    "RigidFooting",
    "Shape",
    "Space",
    "Stabilisation",
    "Surface",
    "TurnedBox",
    "Where",
    "cell_size",
    "figure",
    "fill",
    "fixed",
    "geostatic_stress",
    "ghost",
    "info",
    "materials",
    "momentum",
    "plot",
    "prescribed",
    "rollers",
    "set_stress",
    "soft",
    "steps",
    "study",
]
