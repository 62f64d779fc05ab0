"""Terms of a weak form that a law makes: internal forces, and stress by itself.

Nothing here changes the points: a term declares what its law needs, and the problem
that is made of the form binds it; see `dolfinmpm.forms.declarations`.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import Tags, as_tags, choice, shown, truth
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import check_in_use
from dolfinmpm.forms.declarations import (
    Declaration,
)
from dolfinmpm.forms.operators import PointOperator, PointwiseLaw
from dolfinmpm.kinematics.fbar import FBar
from dolfinmpm.kinematics.frameworks import Framework
from dolfinmpm.kinematics.hyperelastic import declare_energy, end_of_step
from dolfinmpm.kinematics.initial import StressField, take_stress, write_stress
from dolfinmpm.kinematics.jaumann import Jaumann
from dolfinmpm.kinematics.large import LargeStrain
from dolfinmpm.kinematics.small import SmallStrain
from dolfinmpm.kinematics.strainmarks import MARKS, check_history
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean

__all__ = ["flux", "framework", "momentum", "set_stress", "stress"]

CENTRES = "centres"

_FRAMEWORKS: dict[str, type[Framework]] = {
    "large": LargeStrain,
    "small": SmallStrain,
    "jaumann": Jaumann,
}


def framework(
    law: Law | NeoHookean,
    points: MaterialPoints,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> Framework:
    """The law at the points under a measure of strain; nothing is added to them before `bind`.

    Args:
        law: Constitutive law with a kernel.
        points: Material points.
        strain: "large", "small" or "jaumann"; see `momentum`.
        tag: Tags of the points that the law is for; None means all.

    Raises:
        ParameterError: The measure is not known, or the law has no kernel.
    """
    check_points(points)
    strain = choice("strain", strain, _FRAMEWORKS)
    if not isinstance(law, Law) or not law.has_kernel:
        raise ParameterError(
            f"law = {shown(law)} has no kernel of principal strains; use a law such as "
            "mpm.materials.Hencky(E, nu)"
        )
    return _FRAMEWORKS[strain](law, points, as_tags(tag))


def _declare(law, points: MaterialPoints, u, strain: str, fbar: bool | str, tag) -> int:
    """Number of the law's declaration: for the same arguments the same, with one operator."""
    check_points(points)
    check_displacement(points, u=u)
    strain = choice("strain", strain, _FRAMEWORKS)
    tags, fbar = as_tags(tag), _means(fbar, u)
    if tags is None:
        # a field of some points has no strain at others
        tags = getattr(getattr(u, "_dolfinmpm_space", None), "tags", None)
    for number, known in points.declarations.items():
        same = known.law is law and (known.strain, known.fbar, known.tags) == (strain, fbar, tags)
        if same and known.u == u:
            return number
    if isinstance(law, NeoHookean):
        if fbar:
            raise ParameterError(
                f"fbar = True needs a law with a kernel, {type(law).__name__} is an energy in UFL; "
                "use mpm.materials.Hencky"
            )
        if strain != "large":
            raise ParameterError(
                f"strain = {strain!r}: NeoHookean is an energy of large strain and takes "
                'strain="large" only; use a law such as Hencky'
            )
        declaration = declare_energy(law, points, u, tags)
    else:
        declaration = _declare_kernel(law, points, u, strain, fbar, tags)
    number = len(points.declarations)
    points.declarations[number] = declaration
    return number


def _degree(u) -> int:
    """Degree of the basis of an increment; 1 of what is none, which a problem refuses."""
    space = getattr(u, "_dolfinmpm_space", None)
    return space.basis.degree if space is not None else 1


def _means(fbar: Any, u) -> bool | str:
    """Which means F-bar takes: True, False or "centres".

    Raises:
        ParameterError: It is none of them, or splines are to have means over cells.
    """
    if not isinstance(fbar, str):
        return truth("fbar", fbar, CENTRES)
    if fbar != CENTRES:
        raise ParameterError(f"fbar = {shown(fbar)} must be True, False or {CENTRES!r}")
    if _degree(u) > 1:
        raise ParameterError(
            f"fbar = {CENTRES!r} is of linear functions and GIMP: the means of splines of degree "
            f"{_degree(u)} are over splines one degree lower; take fbar=True"
        )
    return CENTRES


def _declare_kernel(law, points, u, strain: str, fbar: bool | str, tags: Tags) -> Declaration:
    inner = framework(law, points, strain, tags)
    # what is no increment of a space is refused when a problem is made
    outer: PointwiseLaw = inner
    if fbar:
        outer = FBar(inner, points, _degree(u), by_centres=fbar == CENTRES)
    operand = gradient(points, u)
    operator = PointOperator(points, outer, operand, operand.ufl_shape, repr(law), tags)

    def bind() -> None:
        check_history(points, inner.rows, strain, str(declaration))
        inner.bind()
        take_stress(inner, str(declaration))
        if isinstance(outer, FBar):
            outer.bind()

    declaration = Declaration(
        points=points, law=law, u=u, strain=strain, fbar=fbar, tags=tags, given={},
        operator=operator, updates={}, mark=MARKS[strain], bind=bind,
        parameters=lambda: inner.parameters(inner.rows), energy=inner.energy,
        stiffness=inner.stiffness, moduli=inner.moduli,
        weaken=None if law.strengths == () else inner.weaken,
    )  # fmt: skip
    operator.declaration = declaration
    return declaration


def momentum(
    law: Law | NeoHookean,
    points: MaterialPoints,
    u: fem.Function,
    v: Any,
    *,
    strain: str = "large",
    fbar: bool | str = False,
    tag: int | tuple[int, ...] | None = None,
) -> ufl.Form:
    """Internal forces of a body, per step: Σ V0 S : ∇̃v, with S from the law and ∇ũ.

    The measures of strain, ∇ũ being the increment's gradient on the grid at the
    start of the step, at axisymmetric points with the hoop term (`mpm.gradient`):

    - "large": logarithmic strain ½ ln(ΔF b_n ΔFᵀ), Kirchhoff stress τ, S = τ ΔF⁻ᵀ; for strains
      and rotations of any size;
    - "small": strain ε_n + sym ∇ũ, S = σ; the linear theory, in which nothing turns;
    - "jaumann": the old strain turned by the increment's spin, plus its rate of
      deformation, Cauchy stress σ, S = J σ ΔF⁻ᵀ; for moderate strains and any rotation, see
      `Jaumann` for its limits.

    Each keeps the elastic strain in its own field (`be` under large strain, else
    `elastic_strain`): a body that has moved under one cannot go on under another, nor
    under an energy, unless `set_stress` gives it the state that belongs to its stress. Another
    law under the same measure takes over the elastic strain; its own internal variables
    start at their first values.

    Nothing is changed until a problem is made of the form: it adds the law's fields to the
    points.

    Args:
        law: Constitutive law: one with a kernel, or one that is an energy in UFL.
        points: Material points.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        strain: "large", "small" or "jaumann"; an energy in UFL takes "large" only.
        fbar: Whether the points in a cell share its mean change of volume, against
            locking of nearly incompressible bodies; see `FBar`. True shares domains of GIMP out
            among the cells that they overlap, "centres" counts each point in the cell of its
            centre, as explicit codes do.
        tag: Tags of the points that the law is for, one or several; None means all that the field
            of u is of. Laws of one form must be for different points.

    Returns:
        A form over the points, to which loads and further terms are added.

    Raises:
        ParameterError: The measure of strain is not known or not one of the law's, a tag is
            no whole number, F-bar is asked for with a law that is an energy, or law, points, u
            or v is something else.
    """
    number = _declare(law, points, u, strain, fbar, tag)
    check_displacement(points, v=v)
    declaration = points.declarations[number]
    tags = declaration.tags
    where = "everywhere" if tags is None else (tags if len(tags) > 1 else tags[0])
    dX = points.dX(where, metadata={**points.dX.metadata(), "law": number})
    if declaration.operator is None:
        energy = law.energy(end_of_step(points, u), **declaration.given)
        term = ufl.derivative(energy * dX, u, v)
    else:
        term = ufl.inner(declaration.operator, gradient(points, v)) * dX
    declaration.terms.extend(integral.integrand() for integral in term.integrals())
    return term


def stress(
    law: Law | NeoHookean,
    points: MaterialPoints,
    u: fem.Function,
    *,
    strain: str = "large",
    fbar: bool | str = False,
    tag: int | tuple[int, ...] | None = None,
) -> Expr:
    """Cauchy stress at the end of the step (Pa), in UFL, for any term over the points.

    The solver derives its tangent, and `ufl.derivative` of it by the increment, as in
    Nitsche's method, is the law's consistent tangent. The derivative of that, which Newton's
    method needs then, is a central difference of the tangent: the law is asked twice more for
    each component of ∇ũ.

    A problem needs the law's `momentum` too, or another term that keeps the stress in balance.
    With the same arguments as there both share one evaluation of the law.

    Args:
        law, points, u, strain, fbar: As for `momentum`.
        tag: Likewise; at other points the stress of a law with a kernel is 0. Restrict the
            term to the same tags, `points.dX(tag)`.

    Returns:
        An expression of shape (strain_dim, strain_dim), which is (3, 3) at axisymmetric points.

    Raises:
        ParameterError: As for `momentum`; or F-bar is asked for under Jaumann's rate.
    """
    number = _declare(law, points, u, strain, fbar, tag)
    declaration = points.declarations[number]
    d, S = points.strain_dim, declaration.operator
    if S is None:
        sigma = law.cauchy_stress(end_of_step(points, u), **declaration.given)
        return ufl.as_tensor([[sigma[i, j] for j in range(d)] for i in range(d)])
    if declaration.strain == "small":
        return S
    if declaration.strain == "jaumann" and fbar:
        raise ParameterError(
            "mpm.stress: there is no stress of fbar=True under Jaumann's rate, whose flux belongs "
            'to the mean volume; use strain="large" or fbar=False'
        )
    # with F-bar the flux holds J/J̄, so that σ = τ/J̄
    dF = ufl.Identity(d) + gradient(points, u)
    return S * dF.T / ufl.det(dF * points.F)


def flux(
    law: Law | NeoHookean,
    points: MaterialPoints,
    u: fem.Function,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> tuple[Expr, Declaration]:
    """What `momentum` multiplies by ∇̃v, per volume at the start of the step (Pa).

    Its product with a normal at the start of the step is the force per area there.

    Args:
        law, points, u, strain, tag: As for `momentum`.

    Returns:
        An expression of shape (gdim, gdim), at axisymmetric points without the hoop term, which no
        normal has a part in, and the law's declaration.
    """
    declaration = points.declarations[_declare(law, points, u, strain, False, tag)]
    d, S = points.strain_dim, declaration.operator
    if S is None:
        sigma = law.cauchy_stress(end_of_step(points, u), **declaration.given)
        own = ufl.as_tensor([[sigma[i, j] for j in range(d)] for i in range(d)])
        dF = ufl.Identity(d) + gradient(points, u)
        S = ufl.det(dF) * own * ufl.inv(dF).T
    elif strain != "small":
        S = S / ufl.det(points.F)
    return in_section(points, S), declaration


@together(own=("stress",))
def set_stress(
    law: Law | NeoHookean,
    points: MaterialPoints,
    stress: StressField,
    *,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> None:
    """Give the points an initial stress, and the elastic strain that goes with it. Collective.

    Sets the state of the measure of strain named (`be` or `elastic_strain`), so that the
    law returns the stress as long as nothing moves, and the field `stress`. Deformation
    gradients, positions and internal variables stay: what the points went through before
    counts as no deformation, under whatever law or measure it was. Call it before or after
    the problem is made, with the same law, measure and tag; the internal variables, such
    as a preconsolidation pressure, must admit the stress by then.

    Args:
        law: The law that the problem uses.
        points: Material points.
        stress: Cauchy stress (Pa), signs as in `MaterialPoints`: shape (3, 3), (n, 3, 3) for all
            points of this rank, or a function of the present positions of the law's points,
            shape (gdim, n), to (n, 3, 3); such as `geostatic_stress` makes.
        strain: Measure of strain of the problem; see `momentum`.
        tag: Tags of the points that get it, those of the law; None means all.

    Raises:
        FieldShapeError: The array has the wrong shape.
        ParameterError: A stress is not finite, not symmetric, or has shear out of the
            dimensions of the points; the law or measure is not known; or no point has the tag.
        StateError: A stress lies outside the yield surface or cannot be reached by elastic
            strain; the message has the point, its stress and its parameters. No point
            is changed then.
    """
    one = framework(law, points, strain, tag)
    check_in_use("tag", points, one.tags)
    one.bind()
    write_stress(one, stress)
    # problems that are there look at it before they go on
    points.revision += 1
