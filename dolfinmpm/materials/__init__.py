"""Constitutive laws."""

from dolfinmpm.materials.base import Law, Parameter, law_kernel
from dolfinmpm.materials.hencky import Hencky
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["Hencky", "Law", "NeoHookean", "Parameter", "law_kernel"]
