"""A trial of a user's kernel: what it reads and writes, and whether it keeps elastic strains.

Guard values lie around all arrays, because Numba cannot check the ends of pointers.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import UserLawError

if TYPE_CHECKING:
    from dolfinmpm.materials.base import Law

__all__ = ["try_kernel"]

Array = npt.NDArray[np.float64]

_GUARDS = 16
# two values of guards and outputs: results that differ depend on what the kernel has not been given
_VALUES = (3.1, 17.7)
# guards of what a kernel reads have other values: an output with them has been written
_READ, _BESIDE = ("parameters", "strain", "old"), 1.3
# at rest, and small and large strains of both signs; soft soil yields at the last ones
_STRAINS = (
    (0.0, 0.0, 0.0), (1e-6, -2e-6, 5e-7), (0.03, 0.01, -0.005), (-0.03, -0.01, 0.005),
    (0.1, -0.2, 0.05),
)  # fmt: skip
# Share of a change of an internal variable that the same step once more must not have
_AGAIN = 0.5


def try_kernel(law: Law) -> None:
    """Call a user's kernel, once per kernel and sizes, and look at what it touches.

    All ranks try the same numbers. For a parameter that varies, a number in its range serves.

    Raises:
        UserLawError: It reads or writes beyond an array, leaves a part of its results unwritten,
            or yields without elastic strains.
    """
    kernel: Any = law.kernel
    sizes = len(law.parameters), len(law.internal)
    if not kernel.is_own or sizes in kernel.tried:
        return
    parameters = np.array([_number(law, name) for name in law.parameters])
    first = law.declared_internal(parameters[None])[0]
    for strain in _STRAINS:
        found = [_call(kernel.compiled, parameters, strain, first, value) for value in _VALUES]
        _judge(law, found)
        if found[0][0] == 0:
            _judge_return(law, parameters, np.array(strain), first, found[0][1])
    kernel.tried.add(sizes)


def _number(law: Law, name: str) -> float:
    value = law.values[name]
    if not callable(value) and np.ndim(value) == 0:
        return float(value)
    low, high = law.parameters[name].low, law.parameters[name].high
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high)
    return low + 1.0 if np.isfinite(low) else min(high - 1.0, 1.0)


def _call(compiled: Any, parameters: Array, strain: Any, first: Array, value: float) -> Any:
    """Status, and the arrays with their guards by name, after a call."""
    given = {"parameters": parameters, "strain": strain, "old": first}
    sizes = {"new": first.size, "stress": 3, "tangent": 9}
    arrays = {}
    for name, content in {**given, **{k: np.full(n, value) for k, n in sizes.items()}}.items():
        arrays[name] = np.full(np.size(content) + 2 * _GUARDS, _guard(name, value))
        arrays[name][_GUARDS : _GUARDS + np.size(content)] = content
    double = ctypes.POINTER(ctypes.c_double)
    pointers = (array[_GUARDS:].ctypes.data_as(double) for array in arrays.values())
    status = compiled.ctypes(*pointers)
    return status, arrays


def _judge_return(law: Law, parameters: Array, strain: Array, first: Array, found: Any) -> None:
    """Raise UserLawError if the kernel yields, and leaves trial strains for the elastic ones.

    From its own results it then yields by as much once more.
    """
    new = _inner(found["new"])
    flow = np.abs(new - first)
    if not flow.any() or not np.array_equal(_inner(found["strain"]), strain):
        return
    kernel: Any = law.kernel
    _, again = _call(kernel.compiled, parameters, strain, new, _VALUES[0])
    more = (flow > 0.0) & (np.abs(_inner(again["new"]) - new) > _AGAIN * flow)
    if more.any():
        raise UserLawError(
            f"{type(law).__name__}: '{list(law.internal)[int(np.argmax(more))]}' changes at the "
            f"trial strains {strain.tolist()}, and as much again if its kernel is called with the "
            "results. After a return mapping a kernel must write the elastic strains: "
            "strain[i] = ..."
        )


def _inner(array: Array) -> Array:
    """An array without its guards."""
    return array[_GUARDS : len(array) - _GUARDS]


def _guard(name: str, value: float) -> float:
    return value + _BESIDE if name in _READ else value


def _judge(law: Law, found: Any) -> None:
    """Raise UserLawError for what two calls with different guards show."""
    name = f"{type(law).__name__}: its kernel"
    results = {}
    for key, one in found[0][1].items():
        pair = one, found[1][1][key]
        size = one.size - 2 * _GUARDS
        inner = slice(_GUARDS, _GUARDS + size)
        results[key] = [array[inner] for array in pair]
        outside = np.delete(one, np.arange(_GUARDS, _GUARDS + size))
        if not (outside == _guard(key, _VALUES[0])).all():
            advice = (
                "declare all internal variables" if key in ("old", "new") else "mend the kernel"
            )
            raise UserLawError(
                f"{name} writes beyond `{key}`, which has {size} numbers here: {advice}"
            )
    if any(status != 0 for status, _ in found):
        return
    for key in ("new", "stress", "tangent"):
        one, other = results[key]
        kept = np.flatnonzero((one == _VALUES[0]) & (other == _VALUES[1]))
        if kept.size:
            raise UserLawError(
                f"{name} does not write {key}[{kept[0]}]: write every entry of {key}"
            )
    for key in ("strain", "new", "stress", "tangent"):
        one, other = results[key]
        if not np.array_equal(one, other, equal_nan=True):
            raise UserLawError(
                f"{name} reads beyond its arrays: `{key}` depends on what lies there. There are "
                f"{len(law.parameters)} parameters and {len(law.internal)} internal variables: "
                "declare all that it reads"
            )
