"""dolfinmpm: an unfitted material point method on FEniCSx."""

from dolfinmpm import materials
from dolfinmpm.boundary import fixed, prescribed, rollers
from dolfinmpm.fill import fill
from dolfinmpm.grid import cell_size
from dolfinmpm.kinematics import momentum
from dolfinmpm.points import MaterialPoints
from dolfinmpm.shapes import Ball, Box, Disc, Polygon, Shape, Where
from dolfinmpm.solve import QuasiStatic
from dolfinmpm.space import Space
from dolfinmpm.stabilise import ghost

__version__ = "0.1.0"
