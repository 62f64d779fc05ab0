"""What a constitutive law declares, and how its kernel is called.

A law works on principal logarithmic strains and Kirchhoff stresses (Pa) in three
dimensions; the kinematics around it are the same for every law. Its kernel is a
C function, so that one compiled loop serves all laws.
"""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import check_function, coordinates, shown
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.grid.positions import ask
from dolfinmpm.materials.discarded import DISCARDED

__all__ = ["Law", "Parameter", "Parametrised", "Response", "Value", "call_law", "law_kernel"]

Array = npt.NDArray[np.float64]
# A number, one for each point of this rank, or a function of first positions, shape (gdim, n)
Value = float | Array | Callable[[Array], npt.ArrayLike]

_PACKAGE = __name__.partition(".")[0] + "."
_DOUBLES = types.CPointer(types.float64)
KERNEL_SIGNATURE = types.int32(_DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES)


class _Kernel:
    """A law's kernel, compiled when its address is first asked for: no scene uses all laws."""

    def __init__(self, function: Callable):
        self._function = function

    @functools.cached_property
    def _compiled(self) -> Any:
        # Numba's cache goes by file and line: to a module under another name, or after a number
        # came from elsewhere, it would give the old kernel. The package's own have no such
        # numbers, and `forget_outdated` sees their sources.
        own = self._function.__module__.startswith(_PACKAGE)
        return numba.cfunc(KERNEL_SIGNATURE, cache=own, error_model="numpy")(self._function)

    @property
    def address(self) -> int:
        """Address of the C function."""
        return self._compiled.address

    @functools.cached_property
    def stress_address(self) -> int:
        """Address of one that writes no tangent, for explicit steps; else the same.

        Only of the package's own kernels: others may do with the tangent what goes with an array
        alone.
        """
        if not self._function.__module__.startswith(_PACKAGE):
            return self.address
        signature = types.int32(*[_DOUBLES] * 5, DISCARDED)
        kept = numba.cfunc(signature, cache=True, error_model="numpy")(self._function)
        self._without_tangent = kept
        return kept.address


def law_kernel(function: Callable) -> _Kernel:
    """Make a law's kernel, which is compiled when a process first uses the law.

    The function takes six arrays and returns 0, or another number if the strain
    admits no stress:

    `kernel(parameters, strain, old, new, stress, tangent)`

    with the parameters in the order declared; the three principal trial
    logarithmic strains, which a law with a return mapping replaces by the elastic
    ones; the internal variables at the start of the step; those at its end
    (written); the three principal Kirchhoff stresses (Pa, written); and the nine
    derivatives of stress by trial strain, row by row (Pa, written).

    Raises:
        ParameterError: It is no function of six arrays.
    """
    check_function("function", function, "of six arrays, kernel(parameters, strain, ...)")
    try:
        inspect.signature(function).bind(*range(6))
    except TypeError as error:
        raise ParameterError(
            f"function = {shown(function)} must take six arrays, parameters, strain, old, new, "
            f"stress and tangent: {error}"
        ) from None
    return _Kernel(function)


@intrinsic
def call_law(typingctx, address, parameters, strain, old, new, stress, tangent):
    """Call a kernel by its address, with the addresses of its arrays; for compiled loops."""
    signature = types.int32(*[types.intp] * 7)

    def generate(context, builder, sig, args):
        from llvmlite import ir

        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer] * 6)
        function = builder.inttoptr(args[0], kind.as_pointer())
        return builder.call(function, [builder.inttoptr(a, pointer) for a in args[1:]])

    return signature, generate


@numba.njit(cache=True, error_model="numpy")
def _respond(law, parameters, strain, old, new, stress, tangent):
    for p in range(strain.shape[0]):
        at = p if parameters.shape[0] > 1 else 0
        status = call_law(
            law, parameters.ctypes.data + 8 * at * parameters.shape[1],
            strain.ctypes.data + 24 * p, old.ctypes.data + 8 * p * old.shape[1],
            new.ctypes.data + 8 * p * new.shape[1], stress.ctypes.data + 24 * p,
            tangent.ctypes.data + 72 * p,
        )  # fmt: skip
        if status != 0:
            return p
    return -1


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law: its unit and the open or closed interval that it may be in.

    Raises:
        ParameterError: The unit is no word, or the limits are no numbers that rise.
    """

    unit: str
    low: float = -math.inf
    high: float = math.inf
    closed: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.unit, str):
            raise ParameterError(f"unit = {shown(self.unit)} must be a word, such as 'Pa'")
        for what in ("low", "high"):
            value = getattr(self, what)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
                raise ParameterError(f"{what} = {shown(value)} must be a number")
        if not self.low < self.high:
            raise ParameterError(f"low = {self.low:g} must be below high = {self.high:g}")

    def check(self, law: str, name: str, value: npt.ArrayLike) -> None:
        """Raise ParameterError unless the value, or every value of an array, is admissible."""
        values = np.asarray(value, float)
        inside = (values >= self.low) & (values <= self.high)
        if not self.closed:
            inside = (values > self.low) & (values < self.high)
        inside &= np.isfinite(values)
        if not inside.all():
            bad = values[~inside].flat[0]
            left, right = ("[", "]") if self.closed else ("(", ")")
            raise ParameterError(
                f"{law}: {name} = {bad} {self.unit} must be in "
                f"{left}{self.low}, {self.high}{right}".replace("  ", " ")
            )


@dataclass(frozen=True)
class Response:
    """What a law answers at n points.

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


class Parametrised:
    """What laws have in common: parameters by name, each checked, and fixed once given.

    A subclass declares `parameters` (name → Parameter), and `admissible` if they bound
    each other. The values are attributes too, `law.E`, to be read only: a law is a value,
    and problems that use it would not learn of another number.

    Attributes:
        values: Name → number, array or function, as given; to be read only.

    Args:
        values: Every parameter: a number, an array with one value for each of the law's
            points of this rank, or a function of their first positions in DOLFINx's
            layout, shape (gdim, n), that returns n values.

    Raises:
        ParameterError: A parameter is missing, unknown or outside its range; or, later, one is
            assigned to.
    """

    parameters: dict[str, Parameter] = {}

    def __init__(self, **values: Value):
        missing = set(self.parameters) ^ set(values)
        if missing:
            raise ParameterError(
                f"{type(self).__name__} takes the parameters {', '.join(self.parameters)}; "
                f"missing or unknown: {', '.join(sorted(missing))}"
            )
        given: dict[str, Value] = {}
        for name in self.parameters:
            value = values[name]
            if isinstance(value, Expr):
                raise ParameterError(self._no_expression(name, value))
            if not callable(value):
                array = self._numbers(name, value)
                self.parameters[name].check(type(self).__name__, name, array)
                # a copy: to change the caller's array must not change the law
                value = float(array) if array.ndim == 0 else array.copy()
                if isinstance(value, np.ndarray):
                    value.flags.writeable = False
            given[name] = value
        self.values: Mapping[str, Value] = MappingProxyType(given)
        if not self.varies:
            self.parameter_array()

    def _no_expression(self, name: str, value: Any) -> str:
        """What is said of a parameter in UFL, which is callable, but no function of positions."""
        unit = self.parameters[name].unit
        return (
            f"{type(self).__name__}: {name} = {shown(value)} is an expression of UFL, and a law is "
            f"a value, whose parameters are read once: give a number{unit and f' ({unit})'}, such "
            f"as float(constant), or a function of positions, {name}=lambda x: ...; for another "
            "number make a new law and a new problem, which compiles nothing anew"
        )

    def _numbers(self, name: str, value: Any) -> Array:
        """A number, or one for each point."""
        try:
            array = None if value is None else np.asarray(value)
            if array is not None and array.dtype != bool:
                return array.astype(float, casting="same_kind")
        except (TypeError, ValueError):
            pass
        unit = self.parameters[name].unit
        unit = unit and f" ({unit})"
        raise ParameterError(
            f"{type(self).__name__}: {name} = {shown(value)} must be a number{unit}, an array with "
            "one for each point of this rank, or a function of positions"
        )

    def __getattr__(self, name: str) -> Any:
        values = self.__dict__.get("values", {})
        if name in values:
            return values[name]
        raise AttributeError(
            f"'{type(self).__name__}' has no attribute '{name}'"
            + (f"; its parameters are {', '.join(values)}" if values else "")
        )

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.parameters:
            raise ParameterError(
                f"{name} = {value!r}: {self!r} is a value, and a problem that uses it would not "
                f"learn of another {name}; make a new law and a new problem with it, which "
                "compiles nothing anew"
            )
        super().__setattr__(name, value)

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where parameters contradict each other.

        Args:
            values: Name → values, all of one shape.
        """

    @property
    def varies(self) -> bool:
        """Whether any parameter differs from point to point."""
        return not all(isinstance(value, float) for value in self.values.values())

    def parameter_array(self, x: Array | None = None) -> Array:
        """The parameters as the kernel takes them.

        Args:
            x: First positions of the points (m), shape (n, gdim); needed if parameters
                vary.

        Returns:
            Shape (1, parameters) if all are numbers, else (n, parameters).

        Raises:
            ParameterError: A value is outside its range, or their number is not that
                of the points.
        """
        name = type(self).__name__
        n = 1 if not self.varies or x is None else len(x)
        result = np.empty((n, len(self.parameters)))
        for k, (key, value) in enumerate(self.values.items()):
            given = value
            if callable(given):
                if x is None:
                    raise ParameterError(f"{name}: {key} is a function and needs positions")
                given = ask(f"{name}: {key}", given, x)
                self.parameters[key].check(name, key, given)
            if np.shape(given) not in ((), (n,)):
                raise ParameterError(
                    f"{name}: {key} has the shape {np.shape(given)}, expected one value for each "
                    f"of {n} points"
                )
            result[:, k] = given
        self.admissible(dict(zip(self.parameters, result.T)))
        return self.completed(result)

    def completed(self, parameters: Array) -> Array:
        """The parameters, and behind them what a kernel takes that follows from them.

        Args:
            parameters: Those declared, shape (n, parameters).
        """
        return parameters

    def __repr__(self) -> str:
        inside = ", ".join(
            f"{name}={value:g}" if isinstance(value, float) else f"{name}=varying"
            for name, value in self.__dict__.get("values", {}).items()
        )
        return f"{type(self).__name__}({inside})"


class Law(Parametrised):
    """Base of the laws whose stress comes from a kernel.

    A subclass declares `parameters` (name → Parameter, in the order in which the
    kernel reads them), `internal` (name → (unit, first value), where the first value
    is a number or the name of a parameter) and `kernel`; and `admissible` if
    parameters bound each other. See `Parametrised` for how values are given.

    A law whose stress by trial strain is symmetric, elastic or of associated flow, says so by
    `symmetric`: linear systems take half the time then. The first tangent is checked.

    What `study.factor_of_safety` divides to reduce its strength it names in `strengths`, and angles
    (degrees) whose tangents that divides in `friction_angles`; an elastic law has none. None says
    that nothing is known of its strength.
    """

    symmetric: bool = False
    strengths: tuple[str, ...] | None = None
    friction_angles: tuple[str, ...] = ()
    internal: dict[str, tuple[str, float | str]] = {}
    kernel: _Kernel

    def _bound_softening(self, what: str, fall: Array, limit: Array, symbol: str = "") -> None:
        """Raise ParameterError where a strength falls too fast for one stress by strain.

        Args:
            what: The strength, in words.
            fall: By how much it falls by plastic strain (Pa), shape (n,).
            limit: What this must be less than (Pa), shape (n,).
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
        """Raise ParameterError where values are never come to, for want of a rate.

        Args:
            values: Name → values, `rate` among them.
            pairs: Names of first and last values.
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

    def _refuse_rate(self, rate: Any, lasts: str, usual: float = 0.0) -> None:
        """Raise ParameterError if a rate is given without the values that it leads to."""
        if isinstance(rate, (int, float)) and rate != usual:
            raise ParameterError(
                f"{type(self).__name__}: rate = {rate:g} leads nowhere: give {lasts}, or leave "
                "rate out"
            )

    @property
    def has_kernel(self) -> bool:
        """Whether it is more than the base of laws."""
        return type(self).address is not Law.address or hasattr(self, "kernel")

    @property
    def address(self) -> int:
        """Address of the compiled kernel."""
        return self.kernel.address

    @property
    def stress_address(self) -> int:
        """Address of a kernel that need not write the tangent."""
        return getattr(self.kernel, "stress_address", self.address)

    def first_internal(self, parameters: Array) -> Array:
        """Internal variables of a point that has not yielded, shape (n, variables)."""
        names = list(self.parameters)
        first = np.empty((len(parameters), len(self.internal)))
        for k, (_, value) in enumerate(self.internal.values()):
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
        """Elastic energy per initial volume (J/m³), shape (n,); None if the law cannot tell.

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

        Elastic λ + 2μ of laws with Young's modulus and Poisson's ratio, else that of the tangent.

        Args:
            strain: Elastic principal strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        if self.has_moduli:
            lmbda, mu = self._lame(parameters)
            return lmbda + 2 * mu
        tangent = self._tangent(strain, internal, parameters)
        return np.abs(np.diagonal(tangent, axis1=1, axis2=2)).max(axis=1, initial=0.0)

    def _tangent(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Derivatives of stress by trial strain (Pa), shape (n, 3, 3); 0 where there is none."""
        n = len(strain)
        elastic, old = np.array(strain, order="C"), np.ascontiguousarray(internal)
        new, stress, tangent = np.empty_like(old), np.empty((n, 3)), np.zeros((n, 3, 3))
        _respond(self.address, parameters, elastic, old, new, stress, tangent)
        return tangent

    def response(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Principal stresses for trial strains (Pa), shape (n, 3); not numbers where none is.

        Args:
            strain: Principal trial strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        n = len(strain)
        trial, old = np.array(strain, order="C"), np.ascontiguousarray(internal)
        new, stress, tangent = np.empty_like(old), np.full((n, 3), np.nan), np.empty((n, 3, 3))
        _respond(self.address, parameters, trial, old, new, stress, tangent)
        return stress

    def moduli(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Elastic P-wave and shear modulus (Pa), shape (n, 2) or (1, 2).

        λ + 2μ and μ of laws with Young's modulus and Poisson's ratio, else the means over the
        axes of the elastic tangent.

        Args:
            strain: Elastic principal strains, shape (n, 3).
            internal: Internal variables, shape (n, variables).
            parameters: Parameters, shape (1, parameters) or (n, parameters).
        """
        if self.has_moduli:
            lmbda, mu = self._lame(parameters)
            return np.stack([lmbda + 2 * mu, mu], axis=1)
        tangent = self._tangent(strain, self.unyielding(internal), parameters)
        along = np.einsum("pii->p", tangent) / 3
        across = (tangent.sum(axis=(1, 2)) - 3 * along) / 6
        return np.stack([along, 0.5 * (along - across)], axis=1)

    def unyielding(self, internal: Array) -> Array:
        """Internal variables with which the elastic response goes on beyond the yield surface.

        Those given, unless the law knows better. A law needs better only if its elastic
        response is not linear: the inversion of stress then passes states outside.

        Args:
            internal: Internal variables, shape (n, variables).
        """
        return internal

    def respond(
        self, strain: npt.ArrayLike, internal: Array | None = None, x: Array | None = None
    ) -> Response:
        """Evaluate the law by itself, away from any grid.

        Args:
            strain: Principal trial logarithmic strains, shape (n, 3).
            internal: Internal variables at the start, shape (n, variables); those of a
                point that has not yielded by default.
            x: Positions for parameters that vary, shape (n, gdim).

        Raises:
            ParameterError: Strains are no numbers, or not three at each point; or internal
                variables are not as many as the law has.
            StateError: A strain admits no stress; the message has the point and its state.
        """
        elastic = _principal(strain)
        n = len(elastic)
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
        new, stress, tangent = np.empty_like(old), np.empty((n, 3)), np.empty((n, 3, 3))
        trial = elastic.copy()
        bad = _respond(self.address, parameters, elastic, old, new, stress, tangent)
        if bad < 0 and not np.isfinite(stress).all():
            # of elastic laws, which ask nothing
            bad = int(np.argmin(np.isfinite(stress).all(axis=1)))
        if bad >= 0:
            raise StateError(self.describe(bad, trial[bad], old[bad], parameters))
        return Response(elastic, new, stress, tangent)

    def describe(self, point: int, strain: Array, internal: Array, parameters: Array) -> str:
        """What is known of a point at which the law finds no stress, for messages."""
        values = parameters[point if len(parameters) > 1 else 0]
        given = ", ".join(f"{k} = {v:g}" for k, v in zip(self.parameters, values))
        state = ", ".join(f"{k} = {v:g}" for k, v in zip(self.internal, internal))
        return (
            f"{type(self).__name__} finds no stress at point {point}: principal trial strains "
            f"{strain.tolist()}, {state or 'no internal variables'}; {given}. "
            "Take smaller steps, or soften less"
        )


def _principal(strain: Any) -> Array:
    """Principal strains as the kernel takes them, shape (n, 3).

    Raises:
        ParameterError: They are not three numbers at each point.
    """
    try:
        found = np.array(strain, float, order="C")
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape[-1:] != (3,):
        raise ParameterError(
            f"strain = {shown(strain)} must be three principal strains at each point, shape (n, 3)"
        )
    return found.reshape(-1, 3)


def lame(E: Any, nu: Any) -> tuple[Any, Any]:
    """Lamé's λ and μ (Pa) from Young's modulus E (Pa) and Poisson's ratio; UFL's too.

    >>> lame(2e6, 0.25)
    (800000.0, 800000.0)
    """
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


ELASTIC = {
    "E": Parameter("Pa", low=0.0),
    "nu": Parameter("", low=-1.0, high=0.5),
}
