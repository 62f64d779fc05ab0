"""Strain formulations: from the increment's gradient to the flux of the momentum balance.

All strain formulations pass principal elastic strains to the same laws. They differ in two points:
the update of the elastic strain by an increment, and the stress measure of the law.
"""

from dolfinmpm.basis.gimp import update_domains
from dolfinmpm.kinematics.deposits import Deposit, Layer
from dolfinmpm.kinematics.formulations import Jaumann, LargeStrain, SmallStrain
from dolfinmpm.kinematics.initialstress import geostatic_stress
from dolfinmpm.kinematics.lawterms import momentum, set_stress, strain_formulation, stress
from dolfinmpm.kinematics.nitsche import dirichlet
from dolfinmpm.kinematics.strainformulation import StrainFormulation
from dolfinmpm.kinematics.walls import signorini

__all__ = [
    "Deposit",
    "Jaumann",
    "LargeStrain",
    "Layer",
    "SmallStrain",
    "StrainFormulation",
    "dirichlet",
    "geostatic_stress",
    "momentum",
    "set_stress",
    "signorini",
    "strain_formulation",
    "stress",
    "update_domains",
]
