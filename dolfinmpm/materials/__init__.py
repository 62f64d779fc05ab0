"""Constitutive laws."""

from dolfinmpm.materials.base import Law
from dolfinmpm.materials.camclay import CamClay
from dolfinmpm.materials.druckerprager import DruckerPrager
from dolfinmpm.materials.hencky import Hencky
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.mohrcoulomb import MohrCoulomb
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.materials.parametrised import Parameter
from dolfinmpm.materials.sands import Sand, sand
from dolfinmpm.materials.tresca import Tresca
from dolfinmpm.materials.uflenergy import EnergyWithYield
from dolfinmpm.materials.umat import UMAT
from dolfinmpm.materials.vonmises import VonMises

__all__ = [
    "UMAT",
    "CamClay",
    "DruckerPrager",
    "EnergyWithYield",
    "Hencky",
    "Law",
    "MohrCoulomb",
    "NeoHookean",
    "Parameter",
    "Sand",
    "Tresca",
    "VonMises",
    "law_kernel",
    "sand",
]
