"""The base of constitutive laws: their declarations and their kernels.

A law works on principal logarithmic strains and Kirchhoff stresses (Pa) in three dimensions. The
kinematics around the law are the same for every law. The kernel is a C function, so that one
compiled loop serves all laws.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import coordinates, floats, shown
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm._platform.units import warn_of_radians
from dolfinmpm.materials.kerneltrial import try_kernel
from dolfinmpm.materials.lawkernel import Kernel, respond_at_points
from dolfinmpm.materials.parametrised import Array, Parameter, Parametrised
from dolfinmpm.materials.tangentcheck import check_law

__all__ = ["ELASTIC", "Law", "Response", "lame"]


@dataclass(frozen=True)
class Response:
    """Response of a law at n points.

    Attributes:
        strain: Elastic principal logarithmic strains, shape (n, 3).
        internal: Internal variables, shape (n, variables).
        stress: Principal Kirchhoff stresses (Pa), shape (n, 3).
        tangent: Derivatives of stress by trial strain (Pa), shape (n, 3, 3).
    """

    strain: Array
    internal: Array
    stress: Array
    tangent: Array


class Law(Parametrised):
    """Base of the laws with a kernel.

    A subclass declares

    - `parameters`: name → Parameter, in the order of the kernel;
    - `internal`: name → (unit, first value); the first value is a number or the name of a
      parameter. Each variable is a field of the points with this name. So ParaView files, pictures
      and checkpoints have it. A variable that the kernel only writes is an output of the law;
    - `kernel`: the kernel, see `law_kernel`;
    - `admissible`: a method, if parameters bound each other;
    - `symmetric`: True if the tangent, stress by trial strain, is symmetric. Elastic laws and
      laws with associated flow have a symmetric tangent. Linear systems then take half the time.
      The first tangent is checked;
    - `strengths`: names of the parameters that `study.factor_of_safety` divides by the factor;
    - `friction_angles`: names of the angles (degrees) whose tangents are divided by the factor;
    - `derived`: names of internal variables that follow from the elastic state, such as a void
      ratio. An initial stress sets them.

    An elastic law has no strengths and no friction angles: both are empty. None means that the
    strength of the law is unknown. See `Parametrised` for the values of parameters.

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.Hencky(E=1e6, nu=0.3)
    >>> isinstance(law, mpm.materials.Law), list(law.parameters), law.strengths
    (True, ['E', 'nu'], ())
    """

    symmetric: bool = False
    strengths: tuple[str, ...] | None = None
    friction_angles: tuple[str, ...] = ()
    internal: dict[str, tuple[str, float | str]] = {}
    derived: tuple[str, ...] = ()
    _told_of_radians = False
    kernel: Kernel

    def _bound_softening(self, what: str, fall: Array, limit: Array, symbol: str = "") -> None:
        """Raise ParameterError where a strength falls so fast that a strain has several stresses.

        Args:
            what: The strength, in words.
            fall: Fall of the strength per plastic strain (Pa), shape (n,).
            limit: Upper bound of the fall (Pa), shape (n,).
            symbol: The limit in symbols, for the message.
        """
        if (fall >= limit).any():
            worst = np.argmax(fall - limit)
            bound = f"{symbol} = {limit[worst]:g}" if symbol else f"{limit[worst]:g}"
            raise ParameterError(
                f"{type(self).__name__}: {what} falls by {fall[worst]:g} Pa per plastic strain, "
                f"must be less than {bound} Pa"
            )

    def _check_rate(self, values: dict[str, Array], pairs: Sequence[tuple[str, str]]) -> None:
        """Raise ParameterError where a last value is never reached, because the rate is zero.

        Args:
            values: Name → values, with the name `rate`.
            pairs: Pairs of names: first value, last value.
        """
        name, rate = type(self).__name__, values["rate"]
        changes = np.zeros(rate.shape, bool)
        for first, last in pairs:
            changes |= values[first] != values[last]
        lasts = " or ".join(last for _, last in pairs)
        if (changes & (rate == 0.0)).any():
            raise ParameterError(
                f"{name}: rate = 0 never leads to {lasts}; such values need a positive rate"
            )

    def _warn_of_radians(self, values: dict[str, Array]) -> None:
        """Warn on rank 0, once per law, if an angle is so small that it may be in radians.

        For an angle that varies over the points the largest value counts.

        Args:
            values: Parameter → values. Parameters with a name that ends in "angle" are in degrees.
        """
        self._told_of_radians = self._told_of_radians or any(
            warn_of_radians(f"{type(self).__name__}: {name}", float(values[name].max(initial=0.0)))
            for name in self.parameters
            if name.endswith("angle")
        )

    def _refuse_rate(self, rate: Any, lasts: str, usual: float = 0.0) -> None:
        """Raise ParameterError if a rate is given without the last values."""
        if isinstance(rate, (int, float)) and rate != usual:
            raise ParameterError(
                f"{type(self).__name__}: rate = {rate:g} has no effect: give {lasts}, or leave "
                "rate out"
            )

    @property
    def has_kernel(self) -> bool:
        """Whether the law has a kernel."""
        return type(self).address is not Law.address or hasattr(self, "kernel")

    @property
    def address(self) -> int:
        """Address of the compiled kernel.

        Raises:
            ParameterError: The law has none.
        """
        found = getattr(self, "kernel", None)
        address = getattr(found, "address", None)
        if address is None:
            raise ParameterError(
                f"{type(self).__name__}: kernel = {shown(found)} must be a function that "
                "mpm.materials.law_kernel has compiled, in the class of the law"
            )
        return int(address)

    @property
    def stress_address(self) -> int:
        """Address of a kernel that need not write the tangent."""
        # laws that compile a kernel of their own have an address and no `kernel`
        return getattr(getattr(self, "kernel", None), "stress_address", self.address)

    def first_internal(self, parameters: Array) -> Array:
        """Internal variables of points before any yielding, shape (n, variables).

        Raises:
            ParameterError: The law declares a variable without a unit and a first value.
            UserLawError: The law's own kernel fails its trial, see `materials.kerneltrial`.
        """
        if isinstance(getattr(self, "kernel", None), Kernel):
            try_kernel(self)
        return self.declared_internal(parameters)

    def declared_internal(self, parameters: Array) -> Array:
        """See `first_internal`; without a trial of the kernel."""
        names = list(self.parameters)
        if not isinstance(self.internal, Mapping):
            raise ParameterError(
                f"{type(self).__name__}: internal = {shown(self.internal)} must be a dictionary, "
                'such as {"plastic_strain": ("", 0.0)}'
            )
        first = np.empty((len(parameters), len(self.internal)))
        for k, (name, declared) in enumerate(self.internal.items()):
            unit, value = declared if isinstance(declared, tuple) else (None, None)
            known = np.isfinite(value) if isinstance(value, Real) else value in names
            if not isinstance(unit, str) or not known:
                raise ParameterError(
                    f"{type(self).__name__}: internal[{name!r}] = {declared!r} must be a unit and "
                    "a first value, (unit, value); the value is a finite number, or one of the "
                    f"parameters {', '.join(names)}"
                )
            first[:, k] = parameters[:, names.index(value)] if isinstance(value, str) else value
        return first

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses, shape (n,); −inf if it never yields.

        Args:
            stress: Principal Kirchhoff stresses (Pa) in any order, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        return np.full(len(stress), -np.inf)

    @property
    def has_moduli(self) -> bool:
        """Whether Young's modulus and Poisson's ratio are among its parameters."""
        return "E" in self.parameters and "nu" in self.parameters

    def _lame(self, parameters: Array) -> tuple[Array, Array]:
        """λ and μ (Pa) of a law that has E and ν, by its parameters."""
        names = list(self.parameters)
        return lame(parameters[:, names.index("E")], parameters[:, names.index("nu")])

    def energy(self, strain: Array, parameters: Array) -> Array | None:
        """Elastic energy per initial volume (J/m³), shape (n,); None if the law has no energy.

        By default ½ λ (tr ε)² + μ ε : ε for laws with Young's modulus and Poisson's ratio.

        Args:
            strain: Elastic principal strains, shape (n, 3).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        if not self.has_moduli:
            return None
        lmbda, mu = self._lame(parameters)
        return 0.5 * lmbda * strain.sum(axis=1) ** 2 + mu * np.sum(strain**2, axis=1)

    def stiffness(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Largest stiffness along one axis (Pa), for wave speeds, shape (n,) or (1,).

        Elastic λ + 2μ of laws with Young's modulus and Poisson's ratio. For other laws it is the
        largest stiffness of the elastic tangent: waves unload points that have yielded.

        Args:
            strain: Elastic principal strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        if self.has_moduli:
            lmbda, mu = self._lame(parameters)
            return lmbda + 2 * mu
        tangent = self.elastic_tangent(strain, internal, parameters)
        return np.abs(np.diagonal(tangent, axis1=1, axis2=2)).max(axis=1, initial=0.0)

    def evaluated(self, strain: Array, internal: Array, parameters: Array) -> tuple[int, Response]:
        """The first point without a stress or -1, and the response at the points before it.

        Elsewhere stresses are NaN, and tangents 0.
        """
        n, old = len(strain), np.ascontiguousarray(internal)
        elastic, new = np.array(strain, order="C"), np.empty_like(old)
        stress, tangent = np.full((n, 3), np.nan), np.zeros((n, 3, 3))
        bad = respond_at_points(self.address, parameters, elastic, old, new, stress, tangent)
        return bad, Response(elastic, new, stress, tangent)

    def response(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Principal stresses for trial strains (Pa), shape (n, 3); NaN where no stress exists.

        Args:
            strain: Principal trial strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        return self.evaluated(strain, internal, parameters)[1].stress

    def moduli(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Elastic P-wave and shear modulus (Pa), shape (n, 2) or (1, 2).

        λ + 2μ and μ of laws with Young's modulus and Poisson's ratio. For other laws the means
        over the axes of the elastic tangent.

        Args:
            strain: Elastic principal strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        if self.has_moduli:
            lmbda, mu = self._lame(parameters)
            return np.stack([lmbda + 2 * mu, mu], axis=1)
        tangent = self.elastic_tangent(strain, internal, parameters)
        along = np.einsum("pii->p", tangent) / 3
        across = (tangent.sum(axis=(1, 2)) - 3 * along) / 6
        return np.stack([along, 0.5 * (along - across)], axis=1)

    def elastic_tangent(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Elastic derivative of the stress by the strain (Pa), shape (n, 3, 3); see `moduli`."""
        return self.evaluated(strain, self.unyielding(internal), parameters)[1].tangent

    def unyielding(self, internal: Array) -> Array:
        """Internal variables that extend the elastic response beyond the yield surface.

        By default the given ones. A law overrides this only if its elastic response is not linear:
        the inversion of stress then passes states outside the yield surface.

        Args:
            internal: Internal variables, shape (n, variables).
        """
        return internal

    def respond(
        self, strain: npt.ArrayLike, *, internal: Array | None = None, x: Array | None = None
    ) -> Response:
        """Evaluate the law alone, without a grid.

        Args:
            strain: Principal trial logarithmic strains, shape (n, 3).
            internal: Internal variables at the start, shape (n, variables). By default those of
                points before any yielding.
            x: Positions for parameters that vary (m), shape (n, gdim).

        Raises:
            ParameterError: Strains are not numbers, or not three per point. Or the number of
                internal variables differs from that of the law.
            StateError: A strain admits no stress. The message has the point and its state.
        """
        trial = _principal(strain)
        n = len(trial)
        if x is not None and (x := coordinates("x", x)).shape[:-1] != (n,):
            raise ParameterError(
                f"x has the shape {x.shape} and must have a position for each strain, ({n}, gdim)"
            )
        parameters = self.parameter_array(x)
        old = self.first_internal(parameters) if internal is None else np.asarray(internal, float)
        if old.shape[-1:] != (len(self.internal),) or old.shape[:-1] not in ((), (1,), (n,)):
            raise ParameterError(
                f"internal has the shape {old.shape} and must have a row for each strain: "
                f"{', '.join(self.internal) or 'no variable'}, {(n, len(self.internal))}"
            )
        old = np.ascontiguousarray(np.broadcast_to(old, (n, len(self.internal))))
        bad, found = self.evaluated(trial, old, parameters)
        if bad < 0 and not np.isfinite(found.stress).all():
            # elastic laws have no internal variables
            bad = int(np.argmin(np.isfinite(found.stress).all(axis=1)))
        if bad >= 0:
            raise StateError(self.describe(bad, trial[bad], old[bad], parameters))
        return found

    def check(self, *, strain: float | None = None, tolerance: float = 1e-3) -> list[str]:
        """Compare the tangent with central differences of the stress; faults as text.

        Trial strains are random, and internal variables are those before any yielding. Strains at
        which the stress has a kink do not count. Parameters are numbers.

        Args:
            strain: Largest trial strain, beyond yield; by default 1e-3, 1e-2 and 1e-1 in turn.
            tolerance: Largest difference, as a share of the largest entry of the tangent.
        """
        return check_law(self, strain, tolerance)

    def describe(self, point: int, strain: Array, internal: Array, parameters: Array) -> str:
        """Message about a point at which the law finds no stress: strains, state, parameters."""
        values = parameters[point if len(parameters) > 1 else 0]
        given = ", ".join(f"{k} = {v:g}" for k, v in zip(self.parameters, values))
        state = ", ".join(f"{k} = {v:g}" for k, v in zip(self.internal, internal))
        advice = "Take a smaller strain"
        if getattr(getattr(self, "kernel", None), "is_own", False):
            advice = "Its kernel did not return 0, or gave a stress that is not finite"
        elif "rate" in self.parameters:
            advice += ", or a smaller fall of strength"
        return (
            f"{type(self).__name__} finds no stress at point {point}: principal trial strains "
            f"{strain.tolist()}, {state or 'no internal variables'}; {given}. {advice}"
        )


def _principal(strain: Any) -> Array:
    """Principal strains in the layout of the kernel, shape (n, 3).

    Raises:
        ParameterError: Strains are not three numbers per point.
    """
    found = floats(strain)
    if found is None or found.shape[-1:] != (3,):
        raise ParameterError(
            f"strain = {shown(strain)} must be three principal strains at each point, shape (n, 3)"
        )
    return found.reshape(-1, 3)


def lame(E: Any, nu: Any) -> tuple[Any, Any]:
    """Lamé's λ and μ (Pa) from Young's modulus E (Pa) and Poisson's ratio; also in UFL.

    >>> lame(2e6, 0.25)
    (800000.0, 800000.0)
    """
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


ELASTIC = {
    "E": Parameter("Pa", low=0.0),
    "nu": Parameter("", low=-1.0, high=0.5),
}
