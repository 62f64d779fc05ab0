"""Hencky's elasticity: Kirchhoff stress linear in logarithmic strain."""

from __future__ import annotations

from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Value
from dolfinmpm.materials.principal import elastic, moduli

__all__ = ["Hencky"]


@law_kernel
def _hencky(parameters, strain, old, new, stress, tangent):
    lmbda, mu = moduli(parameters[0], parameters[1])
    elastic(lmbda, mu, strain[0] + strain[1] + strain[2], strain, stress, tangent)
    return 0


class Hencky(Law):
    """Hencky's law: τ = λ tr(ε) I + 2μ ε, with ε = ½ ln b the logarithmic strain.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.

    Raises:
        ParameterError: A parameter is outside its range.

    Stresses (Pa) of principal strains, away from any grid:

    >>> Hencky(E=2e6, nu=0.25).respond([[1e-3, 0.0, 0.0]]).stress.round(6).tolist()
    [[2400.0, 800.0, 800.0]]
    """

    parameters = ELASTIC
    kernel = _hencky
    symmetric = True
    strengths = ()

    def __init__(self, E: Value, nu: Value):
        super().__init__(E=E, nu=nu)
