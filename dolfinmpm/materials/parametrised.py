"""Parameters of laws: named, with unit and range; checked, and fixed once given."""

from __future__ import annotations

import inspect
import math
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import nearest, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.readonce import set_by_user
from dolfinmpm.grid.userfunctions import call_function

__all__ = ["Array", "Parameter", "Parametrised", "Value"]

Array = npt.NDArray[np.float64]
# A number, one for each point of this rank, or a function of first positions, shape (gdim, n)
Value = float | Array | Callable[[Array], npt.ArrayLike]


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law: its unit and its open or closed interval.

    Raises:
        ParameterError: The unit is not a word, a limit is not a number, or the lower limit is not
            below the upper limit.

    A modulus, any number above 0:

    >>> import dolfinmpm as mpm
    >>> modulus = mpm.materials.Parameter("Pa", low=0.0)
    >>> modulus.unit, modulus.low, modulus.high, modulus.closed
    ('Pa', 0.0, inf, False)
    """

    unit: str
    _: KW_ONLY
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


class ReadOnly(UserDict[str, Any]):
    """A dictionary of a law: its entries can be read, and not changed."""

    def __init__(self, given: Mapping[str, Any]):
        super().__init__()
        self.data = dict(given)

    def __setitem__(self, name: str, value: Any) -> None:
        raise ParameterError(
            f"{name} = {shown(value)}: the parameters of a law are fixed, and a problem that uses "
            "it would not learn of others; make a new law and a new problem with it, which "
            "compiles nothing anew"
        )

    def __delitem__(self, name: str) -> None:
        raise ParameterError(
            f"'{name}' cannot be removed: the parameters of a law are fixed; make a new law and a "
            "new problem with it"
        )

    def __ior__(self, other: Any) -> ReadOnly:  # type: ignore[override,misc]
        # dictionaries of users would be changed in place
        self.update(other)
        return self

    def copy(self) -> dict[str, Any]:  # type: ignore[override]
        """A dictionary that can be changed."""
        return dict(self.data)


class Parametrised:
    """Base of all laws: named parameters, checked and fixed once given.

    A subclass declares `parameters` (name → Parameter), and `admissible` if parameters bound each
    other. The values are also attributes, such as `law.E`, and read-only. A problem reads the
    values once and would not notice a change.

    Attributes:
        values: Name → given number, array or function; read-only.

    Args:
        values: Every parameter. A value is a number, or an array with one value per point of the
            law on this rank. Or it is a function of the points' first positions in DOLFINx's
            layout, shape (gdim, n), that returns n values.

    Raises:
        ParameterError: A parameter is missing, unknown or outside its range. Or a parameter is
            assigned to later.
    """

    parameters: Mapping[str, Parameter] = {}

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        own = cls.__dict__.get("parameters")
        if isinstance(own, dict):
            # they are those of all laws of the class
            cls.parameters = ReadOnly(own)

    def __new__(cls, *numbers: Any, **values: Any):
        """Refuse unknown arguments: Python's own error would propose "nu" for "su"."""
        known = inspect.signature(cls.__init__).parameters
        if not any(one.kind is one.VAR_KEYWORD for one in known.values()):
            _refuse_unknown(cls.__name__, values, list(known)[1:])
        return super().__new__(cls)

    def __init__(self, **values: Value):
        given_parameters: Any = self.parameters
        if not isinstance(given_parameters, Mapping) or not all(
            isinstance(one, Parameter) for one in given_parameters.values()
        ):
            raise ParameterError(
                f"{type(self).__name__}: parameters = {given_parameters!r} must be a dictionary, "
                'such as {"E": mpm.materials.Parameter("Pa", low=0.0)}'
            )
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
        self.values: Mapping[str, Value] = ReadOnly(given)
        if "parameters" in vars(self):
            self.parameters = ReadOnly(self.parameters)
        if not self.varies:
            self.parameter_array()

    def _no_expression(self, name: str, value: Any) -> str:
        """Message about a parameter in UFL: it is callable, but not a function of positions."""
        unit = self.parameters[name].unit
        return (
            f"{type(self).__name__}: {name} = {shown(value)} is an expression of UFL, and a law is "
            f"a value, whose parameters are read once: give a number{unit and f' ({unit})'}, such "
            f"as float(constant), or a function of positions, {name}=lambda x: ...; for another "
            "number make a new law and a new problem, which compiles nothing anew"
        )

    def _numbers(self, name: str, value: Any) -> Array:
        """A number, or an array with one number per point."""
        try:
            array = None if value is None or np.ma.is_masked(value) else np.asarray(value)
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
        if not hasattr(type(self), name) and set_by_user(type(self), name):
            raise ParameterError(
                f"{name} = {shown(value)}: {type(self).__name__} has no attribute {name}, and "
                f"nothing would read it{nearest(name, self.parameters) or '.'} A law is a value: "
                "for other parameters make a new law and a new problem with it"
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
        """The parameters in the layout of the kernel.

        Args:
            x: First positions of the points (m), shape (n, gdim); needed if parameters
                vary.

        Returns:
            Shape (1, parameters) if all are numbers, else (n, parameters).

        Raises:
            ParameterError: A value is outside its range, or the number of values differs from the
                number of points.
        """
        name = type(self).__name__
        n = 1 if not self.varies or x is None else len(x)
        result = np.empty((n, len(self.parameters)))
        for k, (key, value) in enumerate(self.values.items()):
            given = value
            if callable(given):
                if x is None:
                    raise ParameterError(f"{name}: {key} is a function and needs positions")
                given = call_function(f"{name}: {key}", given, x)
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
        """The declared parameters, followed by derived numbers for the kernel.

        Args:
            parameters: The declared parameters, shape (n, parameters).
        """
        return parameters

    def __repr__(self) -> str:
        inside = ", ".join(
            f"{name}={value:g}" if isinstance(value, float) else f"{name}=varying"
            for name, value in self.__dict__.get("values", {}).items()
        )
        return f"{type(self).__name__}({inside})"


def _refuse_unknown(law: str, given: Iterable[str], known: list[str]) -> None:
    """Raise ParameterError for arguments that a law does not have."""
    for name in given:
        if name not in known:
            raise ParameterError(
                f"{law} has no argument {name}{nearest(name, known)}; it has {', '.join(known)}"
            )
