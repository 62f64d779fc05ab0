"""Strain frameworks: from the increment's gradient to the flux of the momentum balance.

All of them hand principal elastic strains to the same laws; they differ in how the
strain of an increment joins that of before, and in which stress the law's is.
"""

from __future__ import annotations

import ufl

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.domains import update_domains
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.operators import PointOperator, PointwiseLaw
from dolfinmpm.kinematics.fbar import FBar
from dolfinmpm.kinematics.frameworks import Framework, parameters_at
from dolfinmpm.kinematics.initial import StressField, geostatic_stress, write_stress
from dolfinmpm.kinematics.jaumann import Jaumann
from dolfinmpm.kinematics.large import LargeStrain
from dolfinmpm.kinematics.small import SmallStrain
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = [
    "Framework",
    "Jaumann",
    "LargeStrain",
    "SmallStrain",
    "framework",
    "geostatic_stress",
    "momentum",
    "parameters_at",
    "set_stress",
    "update_domains",
]

_FRAMEWORKS: dict[str, type[Framework]] = {
    "large": LargeStrain,
    "small": SmallStrain,
    "jaumann": Jaumann,
}


def framework(law: Law | NeoHookean, points: MaterialPoints, strain: str = "large") -> Framework:
    """The law at the points under a measure of strain; asked again, the same one. Collective.

    Args:
        law: Constitutive law with a kernel.
        points: Material points; the law adds its state to their fields.
        strain: "large", "small" or "jaumann"; see `momentum`.

    Raises:
        ParameterError: The measure is not known, or the law has no kernel.
    """
    if strain not in _FRAMEWORKS:
        known = ", ".join(f'"{name}"' for name in _FRAMEWORKS)
        raise ParameterError(f"strain = {strain!r} must be one of {known}")
    if not isinstance(law, Law):
        raise ParameterError(
            f"{type(law).__name__} has no kernel of principal strains; use a law such as Hencky"
        )
    for known_one in points.frameworks:
        if known_one.law is law and type(known_one) is _FRAMEWORKS[strain]:
            return known_one
    points.frameworks.append(_FRAMEWORKS[strain](law, points))
    return points.frameworks[-1]


def momentum(
    law: Law | NeoHookean,
    points: MaterialPoints,
    u,
    v,
    strain: str = "large",
    fbar: bool = False,
) -> ufl.Form:
    """Internal forces of a body, per step: Σ V0 S : ∇̃v, with S from the law and ∇ũ.

    The measures of strain, ∇ũ being the increment's gradient on the grid at the
    start of the step:

    - "large": logarithmic strain ½ ln(ΔF b_n ΔFᵀ), Kirchhoff stress τ, S = τ ΔF⁻ᵀ; for strains
      and rotations of any size;
    - "small": strain ε_n + sym ∇ũ, S = σ; the linear theory, in which nothing turns;
    - "jaumann": the old strain turned by the increment's spin, plus its rate of
      deformation, Cauchy stress σ, S = J σ ΔF⁻ᵀ; for moderate strains and any rotation, see
      `Jaumann` for its limits.

    Each keeps the elastic strain in its own field (`be` under large strain, else
    `elastic_strain`): a body that has moved under one cannot go on under another.

    Args:
        law: Constitutive law: one with a kernel, or one that is an energy in UFL.
        points: Material points; the law adds its state to their fields.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        strain: "large", "small" or "jaumann"; an energy in UFL takes "large" only.
        fbar: Whether neighbouring points share their mean change of volume, against
            locking of nearly incompressible bodies; see `FBar`.

    Returns:
        A form over the points, to which loads and further terms are added.

    Raises:
        ParameterError: The measure of strain is not known or not one of the law's, or
            F-bar is asked for with a law that is an energy or has a dilation angle.
    """
    if isinstance(law, NeoHookean) and fbar:
        raise ParameterError(
            f"fbar = True needs a law with a kernel, {type(law).__name__} is an energy in UFL; use "
            "mpm.materials.Hencky"
        )
    if isinstance(law, NeoHookean) and strain == "large":
        F = (ufl.Identity(points.gdim) + ufl.grad(u)) * points.F
        points.updates["stress"] = law.cauchy_stress(F)
        return ufl.derivative(law.energy(F) * points.dX, u, v)
    if isinstance(law, NeoHookean) and strain in _FRAMEWORKS:
        raise ParameterError(
            f"strain = {strain!r}: NeoHookean is an energy of large strain and takes "
            'strain="large" only; use a law such as Hencky'
        )
    inner = framework(law, points, strain)
    operator: PointwiseLaw = FBar(inner, points) if fbar else inner
    operand = ufl.grad(u)
    stress = PointOperator(points, operator, operand, operand.ufl_shape, repr(law))
    return ufl.inner(stress, ufl.grad(v)) * points.dX


def set_stress(
    points: MaterialPoints,
    law: Law | NeoHookean,
    stress: StressField,
    strain: str = "large",
) -> None:
    """Give the points an initial stress, and the elastic strain that goes with it. Collective.

    Sets the state of the measure of strain named (`be` or `elastic_strain`), so that the
    law returns the stress as long as nothing moves, and the field `stress`. Deformation
    gradients, positions and internal variables stay: what the points went through before
    counts as no deformation. Call it before or after `momentum`, with the same law and
    measure; the internal variables, such as a preconsolidation pressure, must admit the
    stress by then.

    Args:
        points: Material points.
        law: The law that the problem uses.
        stress: Cauchy stress (Pa), tension positive: shape (3, 3), (n, 3, 3) for the points
            of this rank, or a function of their present positions, shape (gdim, n), to
            (n, 3, 3); such as `geostatic_stress` makes.
        strain: Measure of strain of the problem; see `momentum`.

    Raises:
        FieldShapeError: The array has the wrong shape.
        ParameterError: A stress is not finite, not symmetric, or has shear out of the
            dimensions of the points; or the law or measure is not known.
        StateError: A stress lies outside the yield surface or cannot be reached by elastic
            strain; the message has the point, its stress and its parameters. No point
            is changed then.
    """
    write_stress(framework(law, points, strain), stress)
