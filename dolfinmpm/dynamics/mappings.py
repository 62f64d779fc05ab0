"""Velocity mappings: from the points to the grid, and back.

Every mapping starts from mass-weighted sums at the nodes, divided by a nodal mass. The kind of mass
matters most. With a consistent (ghosted) mass PIC is a projection and damps nothing. With a
lumped mass PIC damps velocities that vary from node to node, in every step.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice, number, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveField
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.transfer import collect, moments, scatter, scatter_affine
from dolfinmpm.grid.tensors import inverses

__all__ = ["Mapping", "NodalMotion", "mapping_of"]

Array = npt.NDArray[np.float64]
KINDS = ("pic", "flip", "accel", "apic", "tpic", "xpic", "fmpm")
# they undo the smoothing by a lumped mass; a consistent mass does not smooth
_OF_LUMPED = ("apic", "tpic", "xpic", "fmpm")


@dataclass(frozen=True)
class NodalMotion:
    """Motion of the nodes at the start and at the end of a step.

    Attributes:
        V, A: Velocities (m/s) and accelerations (m/s²) at its start, shape (nodes, d).
        V_end, A_end: Velocities and accelerations at its end, shape (nodes, d).
        u: Displacements in the step (m), shape (nodes, d); None for Δt V_end.
        push: Additional mean accelerations by contact (m/s²), shape (nodes, d); None for none.
    """

    V: Array
    A: Array
    V_end: Array
    A_end: Array
    u: Array | None = None
    push: Array | None = None


@unchanged()
@dataclass(frozen=True)
class Mapping:
    """A velocity mapping.

    - "pic": the points take the grid's velocity (Harlow 1964);
    - "flip": the points add the change of the grid's velocity (Brackbill & Ruppel 1986, doi
      10.1016/0021-9991(86)90211-1); with `share` < 1 the rest is "pic";
    - "accel": the points integrate the grid's accelerations (Xie's implicit algorithm, doi
      10.1002/nag.3599);
    - "apic": "pic" with an affine part that keeps angular momentum (Jiang et al. 2015, doi
      10.1145/2766996; in implicit steps Jiang, Schroeder & Teran 2017, doi
      10.1016/j.jcp.2017.02.050); it is "tpic" on linear functions, whose second moments
      vanish at nodes;
    - "tpic": the same with the velocity's gradient as affine part (Nakamura et al. 2023, doi
      10.1016/j.cma.2022.115720);
    - "xpic": "flip" with the old velocity filtered in `order` stages (Hammerquist & Nairn 2017,
      doi 10.1016/j.cma.2017.01.035);
    - "fmpm": "pic" with the new velocity filtered in the same way (Nairn & Hammerquist 2021, doi
      10.1016/j.cma.2021.113997).

    The last four undo the smoothing by a lumped mass, and need a lumped mass.

    Args:
        kind: Name of the mapping.
        share: For "flip": share of the change of velocity; the rest is "pic".
        order: For "xpic" and "fmpm": number of stages; 1 is "pic".

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    >>> import dolfinmpm as mpm
    >>> mpm.Mapping("flip", share=0.95)
    Mapping(kind='flip', share=0.95, order=2)
    >>> mpm.Mapping("xpic", order=3)
    Mapping(kind='xpic', share=1.0, order=3)
    """

    kind: str = "flip"
    _: KW_ONLY
    share: float = 1.0
    order: int = 2

    def __post_init__(self):
        object.__setattr__(self, "kind", choice("mapping", self.kind, KINDS))
        number("share", self.share, 0.0, 1.0, closed=True)
        whole("order", self.order, 1)
        for name, usual, kinds in (("share", 1.0, ("flip",)), ("order", 2, ("xpic", "fmpm"))):
            given = getattr(self, name)
            if given != usual and self.kind not in kinds:
                raise ParameterError(
                    f'{name} = {given:g} is of {" and ".join(kinds)}, and "{self.kind}" has none: '
                    "leave it out"
                )

    @property
    def flip_share(self) -> float:
        """Share of the point's old velocity and its change; the remainder is the grid's."""
        return self.share if self.kind == "flip" else 0.0

    @property
    def kept_share(self) -> float:
        """Share of the point's old velocity in its new one; the remainder is the grid's."""
        return 1.0 if self.kind == "accel" else self.flip_share

    @property
    def affine(self) -> bool:
        """Whether the points carry an affine part of the velocity."""
        return self.kind in ("apic", "tpic")

    def on(self, basis: Any, mass: str) -> Mapping:
        """The mapping for a basis and a kind of mass.

        Raises:
            ParameterError: The mapping does not work with this kind of mass.
        """
        if mass == "consistent" and self.kind in _OF_LUMPED:
            raise ParameterError(
                f'mapping = "{self.kind}" puts back what a lumped mass smears; a consistent one '
                "smears nothing, and velocities would grow from step to step: give "
                'mass="lumped", or mapping="pic" or "flip"'
            )
        if self.kind == "apic" and basis.degree == 1 and not basis.averaged:
            return replace(self, kind="tpic")
        return self

    def add_fields(self, points: MaterialPoints) -> None:
        """Add the fields of the mapping to the points. Collective."""
        d = points.gdim
        points.add_field("velocity", (d,), "m/s")
        points.add_field("acceleration", (d,), "m/s^2")
        if self.kind == "apic":
            points.add_field("velocity_moment", (d, d), "m^2/s")
        if self.kind == "tpic":
            points.add_field("velocity_gradient", (d, d), "1/s")

    def to_grid(
        self,
        points: MaterialPoints,
        field: ActiveField,
        x_node: Array,
        out: Nodal,
        new: dict[str, Array] | None = None,
    ) -> None:
        """Add the momenta of the points to nodal sums (kg m/s), and sum over ranks. Collective.

        Nodes that follow others have momenta of affine velocities at their own positions, which
        go to the others by Cᵀ. This fits the lumped mass Cᵀ M_L C, see `MassTerms`.

        Args:
            points: The points.
            field: Their field.
            x_node: Positions of the nodes (m).
            out: Nodal sums to add to.
            new: Field → velocities or affine parts to use instead of the points' values.
        """
        given = points.fields if new is None else new
        m, v = point_masses(points), given["velocity"]
        if self.affine:
            s = field.full_stencils
            G = self._gradient(given, points, s, x_node)
            sums = out.arrays[0] if field.C is None else np.zeros_like(out.arrays[0])
            scatter_affine(s, x_node, points["x"], m, v, G, sums)
            if field.C is not None:
                out.arrays[0][...] += field.C.T @ sums
        else:
            scatter(field.stencils, m, v, out.arrays[0])
        out.add_up()

    def at_new_positions(self, new: dict[str, Array], dt: float) -> dict[str, Array]:
        """Motion of the points whose gradients of the velocity refer to their new positions.

        Args:
            new: Result of `to_points`.
            dt: Length of the step (s).
        """
        if self.kind != "tpic":
            return new
        gradient = new["velocity_gradient"]
        turned = gradient @ inverses(np.eye(gradient.shape[-1]) + dt * gradient)
        return new | {"velocity_gradient": turned}

    def to_points(
        self,
        points: MaterialPoints,
        field: ActiveField,
        x_node: Array,
        motion: NodalMotion,
        mass: Mass,
        dt: float,
        gamma: float,
        gradient: Array,
    ) -> dict[str, Array]:
        """New velocities, accelerations and affine parts of the points. Collective.

        Args:
            points: The points at the start of the step.
            field: Their field.
            x_node: Positions of the nodes (m).
            motion: Motion of the nodes.
            mass: Mass at the nodes.
            dt: The step (s).
            gamma: Newmark's γ, by which "accel" weighs the new acceleration.
            gradient: Gradient of the velocity at the end of the step (1/s), for "tpic", shape
                (points, d, d). It is by positions at the end, or at the start if the points have
                yet to move.
        """
        s = field.stencils
        v, a_new = points["velocity"], collect(s, motion.A_end)
        new = {"acceleration": a_new}
        if self.kind == "accel":
            old = points["acceleration"]
            new["velocity"] = v + dt * ((1 - gamma) * old + gamma * a_new)
            if motion.push is not None:
                new["velocity"] += dt * collect(s, motion.push)
        elif self.kind == "flip":
            velocity = v + collect(s, motion.V_end - motion.V)
            if self.share < 1.0:
                velocity = self.share * velocity + (1 - self.share) * collect(s, motion.V_end)
            new["velocity"] = velocity
        elif self.kind == "xpic":
            filtered = self._filtered(points, field, motion.V, mass)
            new["velocity"] = collect(s, filtered + motion.V_end - motion.V)
        elif self.kind == "fmpm":
            new["velocity"] = collect(s, self._filtered(points, field, motion.V_end, mass))
        else:
            new["velocity"] = collect(s, motion.V_end)
            if self.kind == "apic":
                V_p, every, C = new["velocity"], field.full_stencils, field.C
                V_end = motion.V_end if C is None else C @ motion.V_end
                B = moments(every, V_end, V_p, x_node[:, : points.gdim], points["x"])
                if motion.u is not None:
                    # angular momentum refers to the new positions of nodes and points
                    u = motion.u if C is None else C @ motion.u
                    W = moments(every, V_end, V_p, u, collect(every, u))
                    B += 0.5 * (W - np.swapaxes(W, 1, 2))
                new["velocity_moment"] = B
            elif self.kind == "tpic":
                new["velocity_gradient"] = gradient.copy()
        return new

    def _gradient(self, given, points: MaterialPoints, s: Stencils, x_node: Array) -> Array:
        """C, the gradient of the affine part (1/s), shape (points, d, d)."""
        if self.kind == "tpic":
            return given["velocity_gradient"]
        x, nodes = points["x"], x_node[:, : points.gdim]
        D = moments(s, nodes, x, nodes, x)
        return given["velocity_moment"] @ inverses(D)

    def _filtered(self, points: MaterialPoints, field: ActiveField, V: Array, mass: Mass) -> Array:
        """V_k with V_{j+1} = V_j + M_L⁻¹ (M_L V − M V_j), V_1 = V. Collective."""
        m = np.where(mass.lumped > 0, mass.lumped, np.inf)[:, None]
        s, filtered, weights = field.stencils, V, mass.mass_scaling * point_masses(points)
        for _ in range(self.order - 1):
            product = mass.nodal()
            scatter(s, weights, collect(s, filtered), product.arrays[0])
            product.add_up()
            if field.C is not None:
                # Cᵀ M_L C has no row sums to divide by; held components stay
                filtered = filtered + V - mass.solve(product, V).arrays[0]
                continue
            product.spread()
            filtered = filtered + V - product.arrays[0] / m
        return filtered


def mapping_of(given: Any, default: str) -> Mapping:
    """The mapping named by an argument.

    Raises:
        ParameterError: The argument is neither a `Mapping` nor the name of one.
    """
    if given is None:
        return Mapping(default)
    if isinstance(given, Mapping):
        return given
    if isinstance(given, str):
        return Mapping(given)
    raise ParameterError(
        f"mapping = {given!r} must be a dolfinmpm.Mapping or one of {', '.join(KINDS)}"
    )
