"""Saturated soils: coupled deformation and flow of water, in UFL."""

from dolfinmpm.porous.fluid import Fluid, kozeny_carman
from dolfinmpm.porous.mixture import poromechanics

__all__ = ["Fluid", "kozeny_carman", "poromechanics"]
