"""Terms of a weak form with a law: internal forces, and the stress alone.

Terms do not change the points. A term contains the declaration of its law, and the problem that is
made from the form binds the declaration; see `dolfinmpm.forms.declarations`.
"""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, as_tags, choice, shown, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import check_in_use
from dolfinmpm.forms.declarations import Declaration, ElasticResponse, subdomain
from dolfinmpm.forms.operators import PointOperator, PointwiseLaw
from dolfinmpm.kinematics.fbar import OWN_SHARE, VOLUMES, FBar
from dolfinmpm.kinematics.formulations import FORMULATIONS
from dolfinmpm.kinematics.hyperelastic import declare_energy, end_of_step
from dolfinmpm.kinematics.incremental import Incremental
from dolfinmpm.kinematics.initialstress import StressField, take_stress, write_stress
from dolfinmpm.kinematics.strainformulation import StrainFormulation
from dolfinmpm.kinematics.strainhistory import MARKS, check_history
from dolfinmpm.kinematics.strainhistory import UMAT as UMAT_MARK
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.materials.umat import UMAT

__all__ = ["flux", "momentum", "set_stress", "strain_formulation", "stress"]

CENTRES = "centres"


def strain_formulation(
    law: Law | NeoHookean | UMAT,
    points: MaterialPoints,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> StrainFormulation:
    """A law at the points with a strain formulation. Only its method `bind` changes the points.

    Args:
        law: Constitutive law with a kernel.
        points: Material points.
        strain: "large", "small" or "jaumann"; see `momentum`.
        tag: Tags of the points with this law; None means all points.

    Raises:
        ParameterError: The strain formulation is not known, or the law has no kernel.
    """
    check_points(points)
    strain = choice("strain", strain, FORMULATIONS)
    if isinstance(law, UMAT):
        return Incremental(law, points, strain, as_tags(tag))
    if not isinstance(law, Law) or not law.has_kernel:
        raise ParameterError(
            f"law = {shown(law)} has no kernel of principal strains; use a law such as "
            "mpm.materials.Hencky(E, nu)"
        )
    return FORMULATIONS[strain](law, points, as_tags(tag))


def _declare(law, points: MaterialPoints, u, strain: str, fbar: bool | str, tag) -> int:
    """Number of the law's declaration; the same arguments share one declaration."""
    check_points(points)
    check_displacement(points, u=u)
    strain = choice("strain", strain, FORMULATIONS)
    tags, fbar = as_tags(tag), _kind_of_fbar(fbar, u, strain)
    if tags is None:
        # a field with tags has no strain at other points
        tags = getattr(getattr(u, "_dolfinmpm_space", None), "tags", None)
    for number, known in points.declarations.items():
        same = known.law is law and (known.strain, known.fbar, known.tags) == (strain, fbar, tags)
        if same and known.u == u:
            return number
    if isinstance(law, NeoHookean):
        if fbar:
            raise ParameterError(
                f"fbar = True needs a law with a kernel, but {type(law).__name__} is an energy in "
                "UFL; use mpm.materials.Hencky"
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
    """Degree of the basis of an increment; 1 for other functions, which a problem refuses."""
    space = getattr(u, "_dolfinmpm_space", None)
    return space.basis.degree if space is not None else 1


def _kind_of_fbar(fbar: Any, u, strain: str) -> bool | str:
    """Kind of the means of F-bar: True, False, "centres" or "volumes".

    Raises:
        ParameterError: The argument is something else, is "centres" for splines, or is "volumes"
            for another strain than "large" or a total configuration.
    """
    if not isinstance(fbar, str):
        return truth("fbar", fbar, CENTRES, VOLUMES)
    if fbar not in (CENTRES, VOLUMES):
        raise ParameterError(
            f"fbar = {shown(fbar)} must be True, False, {CENTRES!r} or {VOLUMES!r}"
        )
    if fbar == CENTRES and _degree(u) > 1:
        raise ParameterError(
            f"fbar = {CENTRES!r} is for linear functions and GIMP only: the means of splines of "
            f"degree {_degree(u)} are over splines of one degree less; take fbar=True"
        )
    if fbar == VOLUMES:
        space = getattr(u, "_dolfinmpm_space", None)
        if strain != "large" or (space is not None and space.configuration == "total"):
            raise ParameterError(
                f"fbar = {VOLUMES!r} needs strain='large' and the updated configuration, because "
                "other strains keep no mean volume change; take fbar=True"
            )
    return fbar


def _declare_kernel(law, points, u, strain: str, fbar: bool | str, tags: Tags) -> Declaration:
    inner = strain_formulation(law, points, strain, tags)
    outer: PointwiseLaw = inner
    if fbar:
        own_share = OWN_SHARE if fbar == VOLUMES else 0.0
        outer = FBar(inner, points, _degree(u), by_centres=fbar == CENTRES, own_share=own_share)
    operand = gradient(points, u)
    operator = PointOperator(points, outer, operand, operand.ufl_shape, repr(law), tags)

    def bind() -> None:
        if not inner.from_stress:
            check_history(points, inner.rows, strain, str(declaration))
        inner.bind()
        take_stress(inner, str(declaration))
        if isinstance(outer, FBar):
            outer.bind()

    mark = UMAT_MARK if inner.from_stress else strain
    declaration = Declaration(
        points=points, law=law, u=u, strain=strain, fbar=fbar, tags=tags, given={},
        operator=operator, updates={}, mark=MARKS[mark], bind=bind,
        parameters=lambda: inner.parameters(inner.rows),
        elastic=ElasticResponse(inner.energy, inner.stiffness, inner.moduli),
        weaken=None if law.strengths == () else inner.weaken,
    )  # fmt: skip
    operator.declaration = declaration
    return declaration


def momentum(
    law: Law | NeoHookean | UMAT,
    points: MaterialPoints,
    u: fem.Function,
    v: Any,
    *,
    strain: str = "large",
    fbar: bool | str = False,
    tag: int | tuple[int, ...] | None = None,
) -> ufl.Form:
    """Internal forces of a body in a step: Σ V0 S : ∇̃v, with the flux S from the law and ∇ũ.

    ∇ũ is the increment's gradient by positions at the start of the step. At axisymmetric points it
    has the hoop term (`mpm.gradient`). The strain formulations are:

    - "large": logarithmic strain ½ ln(ΔF b_n ΔFᵀ), Kirchhoff stress τ, S = τ ΔF⁻ᵀ; for strains
      and rotations of any size.
    - "small": strain ε_n + sym ∇ũ, S = σ; the linear theory, without rotations.
    - "jaumann": the old strain rotates with the spin of the increment, and the rate of deformation
      is added; Cauchy stress σ, S = J σ ΔF⁻ᵀ; for moderate strains and any rotation. See `Jaumann`
      for its limits.

    Each strain formulation has its own field of the elastic strain: `be` for large strain,
    `elastic_strain` for the others. A body that has moved with one formulation cannot go on with
    another, or with an energy, unless `set_stress` gives it the state for its stress. Another law
    with the same formulation takes over the elastic strain. Its internal variables start at their
    first values.

    This function does not change the points. A problem that is made from the form adds the law's
    fields to the points.

    Args:
        law: Constitutive law with a kernel, or with an energy in UFL.
        points: Material points.
        u: Increment of the displacement in the step (m), `Space.increment`.
        v: Test function, `Space.test`.
        strain: "large", "small" or "jaumann"; an energy in UFL takes only "large".
        fbar: Whether the points in a cell share the mean volume change of the cell (F-bar, see
            `FBar`), against locking of nearly incompressible bodies. With True, a domain of GIMP
            counts in all cells that it overlaps. With "centres", each point counts only in the
            cell of its centre, as in explicit codes. With "volumes", the volumes, the domains and
            F of the points follow the mean, too; see `FBar`. Take it for long flow.
        tag: Tags of the points with this law, one or several; None means all points of u's field.
            Laws in one form must be for different points.

    Returns:
        A form over the points. Add further terms, and subtract loads.

    Raises:
        ParameterError: The strain formulation is not known or not possible for the law; a tag is
            no whole number; fbar is given with a law that is an energy; or law, points, u or v is
            of another kind.

    Two soils by tags:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> lower = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), 2, density=2000.0, tag=1)
    >>> points = lower + mpm.fill(grid, mpm.Box((0, 1), (4, 2)), 2, density=1800.0, tag=2)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(5e6, 0.2), points, V.increment, V.test, tag=1)
    >>> F += mpm.momentum(mpm.materials.NeoHookean(1e6, 0.4), points, V.increment, V.test, tag=2)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    >>> for line in str(problem).splitlines()[2:4]:
    ...     print(line)
    law: Hencky(E=5e+06, nu=0.2), large strain, tags 1
    law: NeoHookean(E=1e+06, nu=0.4), large strain, tags 2
    """
    number = _declare(law, points, u, strain, fbar, tag)
    check_displacement(points, v=v)
    declaration = points.declarations[number]
    dX = points.dX(subdomain(declaration.tags), metadata={**points.dX.metadata(), "law": number})
    if declaration.operator is None:
        energy = law.energy(end_of_step(points, u), **declaration.given)
        term = ufl.derivative(energy * dX, u, v)
    else:
        term = ufl.inner(declaration.operator, gradient(points, v)) * dX
    declaration.terms.extend(integral.integrand() for integral in term.integrals())
    return term


def stress(
    law: Law | NeoHookean | UMAT,
    points: MaterialPoints,
    u: fem.Function,
    *,
    strain: str = "large",
    fbar: bool | str = False,
    tag: int | tuple[int, ...] | None = None,
) -> Expr:
    """Cauchy stress at the end of the step (Pa), in UFL, for any term over the points.

    The solver derives the tangent of the term. `ufl.derivative` of the stress by the increment, as
    in Nitsche's method, is the law's consistent tangent. Newton's method then also needs the
    derivative of this tangent. It is computed by central differences, with two more calls of the
    law per component of ∇ũ.

    A problem also needs the law's `momentum`, or another term that balances the stress. With the
    same arguments, `momentum` and `stress` share one evaluation of the law.

    Args:
        law, points, u, strain, fbar: See `momentum`.
        tag: See `momentum`. At other points the stress of a law with a kernel is 0. Restrict the
            term to the same tags, `points.dX(tag)`.

    Returns:
        An expression of shape (strain_dim, strain_dim), which is (3, 3) at axisymmetric points.

    Raises:
        ParameterError: See `momentum`; or fbar is given with strain="jaumann".

    Internal forces of the linear theory, written out:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> import ufl
    >>> sigma = mpm.stress(mpm.materials.Hencky(1e6, 0.0), points, V.increment, strain="small")
    >>> F = ufl.inner(sigma, ufl.grad(V.test)) * points.dX
    >>> bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.04)
    >>> record = mpm.QuasiStatic(F, V.increment, points, bcs).step()
    >>> points["stress"][0, 1, 1].round(3).item()
    -10000.0
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
            "mpm.stress: fbar=True has no Cauchy stress with Jaumann's rate, because its flux "
            'belongs to the mean volume; use strain="large" or fbar=False'
        )
    # with F-bar the flux contains the factor J/J̄, so that σ = τ/J̄
    dF = ufl.Identity(d) + gradient(points, u)
    return S * dF.T / ufl.det(dF * points.F)


def flux(
    law: Law | NeoHookean | UMAT,
    points: MaterialPoints,
    u: fem.Function,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> tuple[Expr, Declaration]:
    """Flux that multiplies ∇̃v in `momentum`, per volume at the start of the step (Pa).

    The flux times a normal at the start of the step is the force per area at the start.

    Args:
        law, points, u, strain, tag: See `momentum`.

    Returns:
        The flux, an expression of shape (gdim, gdim), and the law's declaration. At axisymmetric
        points the hoop term is left out, because normals have no hoop component.
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


@collective(local=("stress",))
def set_stress(
    law: Law | NeoHookean | UMAT,
    points: MaterialPoints,
    stress: StressField,
    *,
    strain: str = "large",
    tag: int | tuple[int, ...] | None = None,
) -> None:
    """Set an initial stress of the points, and the elastic strain for this stress. Collective.

    The function sets the field `stress` and the elastic strain of the strain formulation (`be` or
    `elastic_strain`). The law then returns the stress as long as nothing moves. Deformation
    gradients, positions and internal variables stay. Earlier deformation no longer counts, with
    any law and strain formulation. Call the function before or after the problem is made, with the
    same law, strain formulation and tag. Internal variables, such as a preconsolidation pressure,
    must admit the stress at the time of the call.

    Args:
        law: The law of the problem.
        points: Material points.
        stress: Cauchy stress (Pa), positive in tension: shape (3, 3); shape (n, 3, 3) for all
            points of this rank; or a function of the present positions (m) of the law's points,
            shape (gdim, n), that returns shape (n, 3, 3), such as `geostatic_stress` makes.
        strain: Strain formulation of the problem; see `momentum`.
        tag: Tags of the points that get the stress, the tags of the law; None means all points.

    Raises:
        FieldShapeError: The array has a wrong shape.
        ParameterError: A stress is not finite, not symmetric, or has shear out of the
            dimensions of the points; the law or the strain formulation is not known; or no point
            has the tag.
        StateError: A stress lies outside the yield surface, or no elastic strain gives it. The
            message has the point, its stress and its parameters. No point is changed.

    Ground at rest; the vertical stress is 20 kN/m³ times the depth of a point:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> law = mpm.materials.Hencky(E=1e6, nu=0.3)
    >>> mpm.set_stress(law, points, mpm.geostatic_stress(surface=2.0, weight=2e4, K0=0.5))
    >>> points["x"][0].tolist(), points["stress"][0].diagonal().round(6).tolist()
    ([0.25, 0.25], [-17500.0, -35000.0, -17500.0])
    """
    one = strain_formulation(law, points, strain, tag)
    check_in_use(points, one.tags)
    one.bind()
    write_stress(one, stress)
    # existing problems check the revision before their next step
    points.revision += 1
