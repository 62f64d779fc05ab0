"""Base of the strain formulations: a law with parameters and state at the points, and the loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.forms.operators import KeptTangents
from dolfinmpm.kinematics.spectral import components, kept_numbers, stress_kernel
from dolfinmpm.kinematics.strainfunctions import StrainFunctions, strain_functions
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Parametrised
from dolfinmpm.materials.strength import weakened

__all__ = ["PointParameters", "StrainFormulation", "symmetric"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]


def symmetric(components: Array) -> Array:
    """Symmetric tensors, shape (..., 3, 3), from xx, yy, zz, xy, yz, zx, shape (..., 6)."""
    return components[..., [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]


class PointParameters:
    """The parameters of a law at its points.

    If a parameter varies, all parameters are a field of the points, `<law>_parameters`, or
    `<law>_parameters_2` for the second law of the same class. Arrays of values are in the order of
    the points at the time of binding; later, points can move to other ranks.

    Attributes:
        field: Name of the field; empty if no parameter varies.

    Args:
        law: The law.
        points: Material points.
        tags: Tags of the points with this law; None means all points.
    """

    def __init__(self, law: Parametrised, points: MaterialPoints, tags: Tags):
        self.law = law
        self.points = points
        self.tags = tags
        self.field = ""
        if law.varies:
            if not any(law is known for known in points.laws):
                points.laws.append(law)
            same = [known for known in points.laws if type(known) is type(law)]
            number = next(k for k, known in enumerate(same, 1) if known is law)
            self.field = f"{type(law).__name__.lower()}_parameters"
            self.field += f"_{number}" if number > 1 else ""
        else:
            self._numbers = law.parameter_array()

    def adopt(self) -> None:
        """Set the parameters of the law's points that have no parameters yet. Collective.

        Raises:
            ParameterError: A value is out of range, or the number of values is not the number of
                points.
        """
        if not self.field:
            return
        points = self.points
        new = self.field not in points.fields
        rows = rows_within(points, self.tags)
        if not new:
            rows = rows[np.isnan(points[self.field][rows, 0])]
        # an array has values only for the first points: later calls need it only for new points
        asked = new or rows.size > 0
        values = call_together(
            points.comm, lambda: self.law.parameter_array(points["x0"][rows]) if asked else None
        )
        if values is not None:
            # the arrays may have more columns: numbers that a kernel derives from the parameters
            points.add_field(self.field, values.shape[1:], "", np.nan)
            points[self.field][rows] = values

    def weaken(self, factor: float | None) -> None:
        """Divide the strength of the law by a factor, see `weakened`. Collective.

        If parameters vary, a further field of the points keeps the first values until a call with
        None.

        Args:
            factor: The factor; 0 for a body that does not yield, None for the full strength.

        Raises:
            ParameterError: The law does not tell its strength, or the reduced parameters
                contradict each other.
        """
        law, points = self.law, self.points
        assert isinstance(law, Law)
        if not self.field:
            own = law.parameter_array()
            self._numbers = own if factor is None else weakened(law, own, factor)
            return
        first = f"{self.field}_first"
        if factor is None:
            if first in points.fields:
                points.fields[self.field] = points.fields[first]
                del points.fields[first]
            return
        if first not in points.fields:
            points.fields[first] = points[self.field].copy()
        rows = rows_within(points, self.tags)
        own = points.fields[first][rows]
        found = call_together(points.comm, lambda: weakened(law, own, factor) if len(own) else own)
        points[self.field][rows] = found

    def at(self, rows) -> Array:
        """Parameters at some points, shape (1, parameters), or (len(rows), parameters) if varying.

        Args:
            rows: Numbers of the points on this rank, or a slice.
        """
        return self.points[self.field][rows] if self.field else self._numbers


class StrainFormulation:
    """A law with one strain formulation, as an operator of the increment's gradient.

    Binding adds fields to the points: the field `state`, with six components of the elastic strain
    tensor (xx, yy, zz, xy, yz, zx); one field per internal variable of the law, with the
    variable's name; and the field of `PointParameters`. Laws for different tags share these
    fields. Each law writes only its own points. At points of other laws, its internal variables
    are 0.

    A subclass names its `StrainFunctions`. In `evaluate` the gradient gives a trial tensor,
    `stress_kernel` computes the law's stress from the trial tensor, and the stress gives the flux.

    Attributes:
        strain: Name of the strain formulation.
        functions: The strain formulation in UFL.
        multiplicative: True if deformation increments are multiplied, and the law's stress is
            the Kirchhoff stress. False if strain increments are added, and the law's stress is the
            Cauchy stress.
        state: Name of the field of the elastic strain.
        rest: Value of this field without elastic strain.
        from_stress: True if the state of the law is the field `stress` itself.
        keeps: How many numbers per point are kept between residual and tangent; see `KeepingLaw`.

    Args:
        law: Constitutive law.
        points: Material points.
        tags: Tags of the points with this law; None means all points.
    """

    strain: str
    multiplicative: bool
    state: str
    rest: tuple[float, ...]
    functions: type[StrainFunctions]
    from_stress = False

    def __init__(self, law: Law, points: MaterialPoints, tags: Tags = None):
        self.law = law
        self.points = points
        self.tags = tags
        self._parameters = PointParameters(law, points, tags)
        self._compiled = strain_functions(self.functions, points.strain_dim)  # type: ignore[arg-type]
        self._kernel = stress_kernel(points.strain_dim)
        self.keeps = kept_numbers(points.strain_dim, len(law.internal))
        # addresses of compiled functions: without and with the tangent, within and at the end
        self._addresses: dict[tuple[bool, bool], tuple[int, ...]] = {}

    @property
    def rows(self) -> Rows:
        """Numbers of the law's points on this rank, shape (n,)."""
        return rows_within(self.points, self.tags)

    def bind(self) -> None:
        """Add the fields, and give first values to points without values. Collective.

        Raises:
            ParameterError: A varying parameter is out of range at a point.
        """
        self._parameters.adopt()
        points, rows = self.points, self.rows
        points.add_field(self.state, (6,), "", self.rest)
        first = np.broadcast_to(self.first_internal(rows), (len(rows), len(self.law.internal)))
        for k, (name, (unit, _)) in enumerate(self.law.internal.items()):
            # whether a point has a value already: laws differ in their first values
            known = f"has_{name}"
            if known not in points.fields:
                given = name in points.fields
                points.fields[known] = np.full(len(points), given, np.int8)
                points.add_field(name, (), unit)
            new = points[known][rows] == 0
            points[name][rows[new]] = first[new, k]
            points[known][rows] = 1

    def first_internal(self, rows: Rows) -> Array:
        """First values of the internal variables at some points, shape (1 or rows, variables)."""
        return self.law.first_internal(self.parameters(rows))

    def parameters(self, rows: Rows | slice) -> Array:
        """The law's parameters at some points, shape (1, parameters).

        The shape is (rows, parameters) if a parameter varies.
        """
        return self._parameters.at(rows)

    def weaken(self, factor: float | None) -> None:
        """Divide the law's strength by a factor; see `PointParameters.weaken`. Collective."""
        self._parameters.weaken(factor)

    def internal(self, rows: Rows | slice) -> Array:
        """The law's internal variables at some points, shape (rows, variables)."""
        columns = [self.points.fields[name][rows] for name in self.law.internal]
        if columns:
            return np.stack(columns, axis=1)
        number = len(range(len(self.points))[rows]) if isinstance(rows, slice) else len(rows)
        return np.empty((number, 0))

    def principal(self, rows: Rows) -> Array:
        """Elastic principal strains of some points (-), shape (rows, 3)."""
        strain: Array = np.empty((0, 3))
        if len(rows):
            tensor = symmetric(self.points[self.state][rows])
            strain = np.asarray(np.linalg.eigvalsh(tensor), np.float64)
        return 0.5 * np.log(strain) if self._compiled.logarithmic else strain

    def energy(self) -> Array | None:
        """Elastic energy per initial volume at the law's points (J/m³), or None if not known."""
        rows = self.rows
        return self.law.energy(self.principal(rows), self.parameters(rows))

    def stiffness(self) -> Array:
        """Largest stiffness along one axis at the law's points (Pa), for wave speeds."""
        return self._of_state(self.law.stiffness)

    def moduli(self) -> Array:
        """Elastic P-wave and shear modulus at the law's points (Pa); see `Law.moduli`."""
        return self._of_state(self.law.moduli)

    def _of_state(self, modulus: Callable[[Array, Array, Array], Array]) -> Array:
        """Result of a law's function of elastic strains, internal variables and parameters."""
        rows = self.rows
        # laws with elastic moduli do not use the strains
        strain = np.empty((len(rows), 3)) if self.law.has_moduli else self.principal(rows)
        return modulus(strain, self.internal(rows), self.parameters(rows))

    def evaluate(
        self,
        operand: Array,
        value: Array,
        tangent: Array | None,
        rows: Rows,
        kept: KeptTangents | None = None,
        end: tuple[Array, Array, Array] | None = None,
    ) -> int:
        """Compute the flux S (Pa) and its derivative by ∇ũ; see `KeepingLaw`.

        With `end`, write the elastic strain, the internal variables and the Cauchy stress (Pa) at
        the end of the step there instead; then `value` has no rows.
        """
        if len(rows) == 0:
            return -1
        points, compiled = self.points, self._compiled
        values, known = (
            (np.empty((1, self.keeps)), False) if kept is None else (kept.values, kept.known)
        )
        new, internal, sigma = (np.empty((0, 6)),) * 3 if end is None else end
        asked = tangent is not None, end is not None
        if asked not in self._addresses:
            self._addresses[asked] = (self.law.address, *compiled.programs(*asked))
        law, *programs = self._addresses[asked]
        return self._kernel(
            law, self.parameters(rows), tuple(programs), compiled.checks, compiled.logarithmic,
            np.ascontiguousarray(operand), np.ascontiguousarray(rows, np.int32), points["F"],
            points[self.state], self.internal(rows), values, known, value,
            np.empty((0, 1, 1)) if tangent is None else tangent, new, internal, sigma,
        )  # fmt: skip

    def commit(
        self, operand: Array, rows: Rows, kept: KeptTangents | None = None
    ) -> dict[str, Array]:
        """Elastic strain, internal variables and Cauchy stress at the end of the step."""
        n = len(rows)
        new, sigma = np.empty((n, 6)), np.empty((n, 6))
        internal = np.empty((n, len(self.law.internal)))
        bad = self.evaluate(operand, np.empty((0, 1)), None, rows, kept, (new, internal, sigma))
        if bad >= 0:
            new[bad:] = sigma[bad:] = np.nan
        fields = {self.state: new, "stress": symmetric(sigma)}
        return fields | {name: internal[:, k].copy() for k, name in enumerate(self.law.internal)}

    def trial_strain(self, operand: Array, rows: Rows) -> Array:
        """Trial elastic strain tensors of some points (-), the argument of the law.

        Args:
            operand: Gradients of the increment at these points, shape (n, d, d).
            rows: Numbers of the points on this rank, shape (n,).

        Returns:
            Tensors, shape (n, 3, 3); NaN at points that the increment turns inside out.
        """
        H = np.array(operand, float).reshape(len(rows), self.points.strain_dim**2)
        state = self.points[self.state][rows]
        trial, good = self._compiled.trials(H, state)
        six = components(3)
        for k, index in enumerate(components(self.points.strain_dim)):
            state[:, six.index(index)] = trial[:, k]
        tensor = symmetric(state)
        good &= np.isfinite(trial).all(axis=1)
        tensor[~good] = np.eye(3)
        if self._compiled.logarithmic:
            values, Q = np.linalg.eigh(tensor)
            with np.errstate(divide="ignore", invalid="ignore"):
                tensor = (Q * (0.5 * np.log(values))[:, None, :]) @ np.swapaxes(Q, -1, -2)
        tensor[~good] = np.nan
        return tensor

    def describe(self, operand: Array, row: int) -> str:
        """Description of a point at which the law found no stress, for messages.

        Args:
            operand: Gradient of the increment at the point, shape (d, d).
            row: Number of the point on this rank.
        """
        d = self.points.strain_dim
        H = np.asarray(operand, float).reshape(1, d, d)
        det = float(np.linalg.det(np.eye(d) + H[0]))
        trial = self.trial_strain(H, np.array([row], np.int32))[0]
        if not np.isfinite(trial).all():
            return f"det ΔF = {det:.4g} of the increment turns the point inside out"
        one = slice(row, row + 1)
        number = int(self.points["id"][row])
        strain = np.linalg.eigvalsh(trial)
        return self.law.describe(number, strain, self.internal(one)[0], self.parameters(one))
