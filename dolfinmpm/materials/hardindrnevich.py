"""Small-strain stiffness and cycles: Hardin and Drnevich's hyperbola with Masing's rule."""

from __future__ import annotations

import math

import numpy as np

from dolfinmpm._platform.argumentchecks import number, refuse_idle, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.cyclickernel import PROPERTIES, cyclic_address
from dolfinmpm.materials.druckerprager import cone
from dolfinmpm.materials.parametrised import Array, Parameter, Parametrised
from dolfinmpm.materials.umat import UMAT

__all__ = ["HardinDrnevich"]

_COMPONENTS = ("11", "22", "33", "12", "13", "23")

# Reversals that a point can keep
_MOST_REVERSALS = 1000
# Reference strain that no soil has: clay of the highest plasticity has some 0.005
_LARGEST_STRAIN = 0.03


class HardinDrnevich(UMAT):
    """Stiffness that falls with shear strain, loops under cycles, and a cone of strength.

    The law is incremental, as a `UMAT` is: use strain="jaumann" or strain="small". With the
    deviators s and e of stress and strain and γ(d) = √2 |d|, which is the shear strain in simple
    shear:

    - first loading: s = 2 G₀ e/(1 + a γ(e)/γ₀.₇), so G/G₀ = 1/(1 + a γ/γ₀.₇) (Hardin & Drnevich
      1972; dos Santos & Correia 2001 for a = 0.385);
    - after a reversal at (s_r, e_r): s − s_r = 2 G₀ d/(1 + a γ(d)/(2 γ₀.₇)), d = e − e_r (Masing
      1926). A step whose increment points back to e_r is a reversal. A loop that comes back to its
      reversal is closed, and the branch that it has interrupted goes on;
    - Drucker and Prager's cone without dilatancy, fitted to Mohr and Coulomb's strength in plane
      strain. Strain beyond the cone is plastic: it does not count in e and e_r. A first stress
      beyond the cone is refused; in sand that of K0 = 1 − sin φ is so for φ above 35.9°;
    - bulk modulus K = 2 G₀ (1 + ν)/(3 (1 − 2ν)). G₀ = G_ref ((p + c cot φ)/(p_ref + c cot φ))^m
      with the pressure p at the start of the step, and at least 1 % of p_ref.

    The hyperbola alone has the bound τ = G₀ γ₀.₇/a: the cone matters where it is below this bound.

    The memory is the strain since the first step and the reversals of loops that are open. They
    are tensors, among the state variables: they rotate with the material. A change of direction
    by less than 90° is no reversal. Where no room is left for a reversal, the way goes back along
    its branch without a loop. The elastic part of HSsmall (Benz 2007) has the same rules for one
    loop.

    Args:
        G: Shear modulus at small strain G_ref (Pa), positive.
        nu: Poisson's ratio at small strain, −1 < ν < 0.5.
        reference_strain: γ₀.₇, the shear strain at which G/G₀ = 1/(1 + a), positive.
        a: Shape of the hyperbola, positive.
        cohesion: c (Pa), not negative; math.inf for no strength.
        friction_angle: φ (degrees), at least 0 and below 90.
        exponent: m, from 0 to 1.
        reference_pressure: p_ref (Pa), positive.
        reversals: Number of reversals that are remembered, at least 2.

    Raises:
        ParameterError: A parameter is outside its range, or differs from point to point.

    Half the stiffness at γ = γ₀.₇/a:

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.HardinDrnevich(G=60e6, nu=0.2, reference_strain=1e-4)
    >>> shear = mpm.study.element_test(law, "simple shear", 1e-4 / 0.385, steps=1)
    >>> round(shear["stress_xy"][-1] / shear["strain_xy"][-1])
    30000000
    """

    parameters = {
        "G": Parameter("Pa", low=0.0),
        "nu": Parameter("", low=-1.0, high=0.5),
        "reference_strain": Parameter("", low=0.0),
        "a": Parameter("", low=0.0),
        "friction_angle": Parameter("degrees", low=0.0, high=89.0, closed=True),
        "exponent": Parameter("", low=0.0, high=1.0, closed=True),
        "reference_pressure": Parameter("Pa", low=0.0),
    }

    def __init__(
        self,
        G: float,
        nu: float,
        *,
        reference_strain: float,
        a: float = 0.385,
        cohesion: float = math.inf,
        friction_angle: float = 0.0,
        exponent: float = 0.0,
        reference_pressure: float = 100e3,
        reversals: int = 8,
    ):
        Parametrised.__init__(
            self,
            G=G,
            nu=nu,
            reference_strain=reference_strain,
            a=a,
            friction_angle=friction_angle,
            exponent=exponent,
            reference_pressure=reference_pressure,
        )
        if self.varies:
            raise ParameterError(
                "HardinDrnevich takes numbers: for other parameters at some points make a further "
                "law, and give both to points by tags"
            )
        if reference_strain > _LARGEST_STRAIN:
            raise ParameterError(
                f"HardinDrnevich: reference_strain = {reference_strain:g} must be at most "
                f"{_LARGEST_STRAIN:g}: that of soil is 1e-5 to 1e-2. It is a strain, not per cent"
            )
        number("HardinDrnevich: cohesion", cohesion, 0.0, math.inf, "Pa", closed=True)
        if cohesion == 0.0 and friction_angle == 0.0:
            raise ParameterError(
                "HardinDrnevich: cohesion = 0 Pa and friction_angle = 0 leave no strength: give "
                "one of them, or no cohesion at all for a law without a bound of strength"
            )
        if exponent == 0.0:
            why = "stiffness does not follow the pressure: give exponent="
            refuse_idle("reference_pressure", reference_pressure, 100e3, why)
        if math.isinf(cohesion):
            why = "there is no bound of strength: give cohesion=, 0 for sand"
            refuse_idle("friction_angle", friction_angle, 0.0, why)
        levels = whole("reversals", reversals, 2)
        if levels > _MOST_REVERSALS:
            raise ParameterError(
                f"HardinDrnevich: reversals = {shown(levels)} must be at most {_MOST_REVERSALS}: "
                "each takes six numbers per point, and small loops forget them; 8 are usual"
            )
        self.cohesion = float(cohesion)
        self.properties = self._properties().ravel()
        self.properties.flags.writeable = False
        names = [f"memory_strain_{ij}" for ij in _COMPONENTS] + ["reversals"]
        names += [f"reversal_{k + 1}_{ij}" for k in range(levels) for ij in _COMPONENTS]
        self._first = dict.fromkeys(names, 0.0)
        self.internal = dict.fromkeys(names, ("", 0.0))
        self.name = np.frombuffer(b"HardinDrnevich".ljust(80), np.uint8).copy()

    def _properties(self) -> Array:
        """The numbers of the kernel, by the names `PROPERTIES`."""
        angle, c = math.radians(self.friction_angle), self.cohesion
        strength, slope, attraction = math.inf, 0.0, 0.0
        if math.isfinite(c):
            eta, xi = cone(np.array([angle]), "plane strain")
            slope, strength = float(eta[0]), c * float(xi[0])
            attraction = c / math.tan(angle) if angle > 0.0 else 0.0
        found = {
            "modulus": self.G, "bulk_share": 2 * (1 + self.nu) / (3 * (1 - 2 * self.nu)),
            "reference_strain": self.reference_strain, "fall": self.a, "exponent": self.exponent,
            "reference_pressure": self.reference_pressure, "attraction": attraction,
            "strength": strength, "slope": slope,
        }  # fmt: skip
        return np.array([found[name] for name in PROPERTIES])

    @property
    def address(self) -> int:
        """Address of the compiled kernel."""
        return cyclic_address()

    @property
    def library(self) -> str:
        """The kernel is no library."""
        return ""

    def beyond_strength(self, stress: Array) -> Array:
        """f = √J₂ + η p − ξ c of the cone (Pa), shape (n,); see `UMAT.beyond_strength`."""
        strength, slope = self.properties[-2:]
        p = np.trace(stress, axis1=1, axis2=2) / 3.0
        deviator = stress - p[:, None, None] * np.eye(3)
        return np.sqrt(0.5 * np.sum(deviator**2, axis=(1, 2))) + slope * p - strength

    def try_once(self, row: Array, components: int) -> None:
        """Nothing: the kernel is the package's own; see `UMAT.try_once`."""

    def __repr__(self) -> str:
        return (
            f"HardinDrnevich(G={self.G:g}, nu={self.nu:g}, "
            f"reference_strain={self.reference_strain:g}, a={self.a:g}, "
            f"cohesion={self.cohesion:g}, friction_angle={self.friction_angle:g})"
        )
