"""Named errors and warnings, raised on all ranks together.

If only one rank raises an exception, the other ranks wait for ever in the next collective call.
Every check that can fail on some ranks therefore ends in `raise_together`.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

__all__ = [
    "BuriedLoadWarning",
    "CheckpointError",
    "ConflictingConditionsError",
    "ConvergenceError",
    "DegreesWarning",
    "DifferentCallsError",
    "DifferentProblemWarning",
    "DolfinMPMError",
    "DolfinMPMWarning",
    "DoubtfulInputWarning",
    "DriftingRecordWarning",
    "EmptyShapeError",
    "FieldShapeError",
    "FormError",
    "FreeAxisWarning",
    "FreeMotionWarning",
    "HeldLoadWarning",
    "IdleConditionWarning",
    "IdlePointsWarning",
    "ImbalanceWarning",
    "InstabilityError",
    "LocalValueWarning",
    "LongPiecesWarning",
    "LostMomentumWarning",
    "MigrationError",
    "MissingPackageError",
    "OverlapWarning",
    "ParameterError",
    "PointsOutsideGridError",
    "RoughShapeWarning",
    "SectionAtEndWarning",
    "ShapeOutsideGridError",
    "SingularMassWarning",
    "SmallBodyWarning",
    "SoftVolumeWarning",
    "StateError",
    "UndeterminedFieldError",
    "UnknownNameError",
    "UnreadOptionWarning",
    "UnstablePairWarning",
    "UnsupportedGridError",
    "UserLawError",
    "WideComparisonWarning",
    "call_on_root",
    "call_together",
    "common_text",
    "raise_together",
    "warn",
]

Result = TypeVar("Result")
_PACKAGE = str(Path(__file__).resolve().parents[1])

_COMMON = "_text_on_all_ranks"


class DolfinMPMError(Exception):
    """Base class of every error that dolfinmpm raises."""


class ParameterError(DolfinMPMError, ValueError):
    """An argument has a value that is not allowed."""


class UnknownNameError(ParameterError, KeyError, AttributeError):
    """Nothing has the given name."""

    # a KeyError shows its message in quotes
    __str__ = Exception.__str__


class DifferentCallsError(DolfinMPMError, RuntimeError):
    """Ranks make different calls, and all ranks must make the same call."""


class FieldShapeError(DolfinMPMError, ValueError):
    """An array has the wrong shape."""


class ShapeOutsideGridError(DolfinMPMError, ValueError):
    """A shape for material points reaches outside the background grid."""


class EmptyShapeError(DolfinMPMError, ValueError):
    """No material point falls into a shape."""


class UnsupportedGridError(DolfinMPMError, ValueError):
    """The background grid does not have the properties that a function needs."""


class ConflictingConditionsError(DolfinMPMError, ValueError):
    """Two essential conditions prescribe different values for one unknown."""


class FormError(DolfinMPMError, ValueError):
    """A term of the weak form cannot be evaluated."""


class MissingPackageError(DolfinMPMError, ImportError):
    """An optional package or program is necessary for a call, and is not installed."""


class PointsOutsideGridError(DolfinMPMError, RuntimeError):
    """Material points left the background grid during a step."""


class MigrationError(DolfinMPMError, RuntimeError):
    """Material points were lost or doubled between ranks."""


class StateError(DolfinMPMError, RuntimeError):
    """A constitutive law finds no stress for a strain."""


class UserLawError(DolfinMPMError, RuntimeError):
    """A UMAT or a kernel of one's own cannot be compiled, or is faulty."""


class CheckpointError(DolfinMPMError, RuntimeError):
    """A checkpoint cannot be written or read, or belongs to another problem."""


class ConvergenceError(DolfinMPMError, RuntimeError):
    """A step did not converge, even with the smallest substeps."""


class UndeterminedFieldError(DolfinMPMError, RuntimeError):
    """A field is determined only up to a constant."""


class InstabilityError(DolfinMPMError, RuntimeError):
    """An explicit computation became unstable."""


class DolfinMPMWarning(UserWarning):
    """Base class of every warning of dolfinmpm; one rank gives the warning."""


class IdleConditionWarning(DolfinMPMWarning):
    """A condition or a load acts on no part of the body, or sizes for `refine` on no cell."""


class IdlePointsWarning(DolfinMPMWarning):
    """Points of a tag have no law, or no term of a field, and are a hole in the body."""


class FreeAxisWarning(DolfinMPMWarning):
    """An axisymmetric body reaches the axis without a radial condition there."""


class FreeMotionWarning(DolfinMPMWarning):
    """Nothing holds a rigid motion of a body without inertia, which may lie anywhere along it."""


class HeldLoadWarning(DolfinMPMWarning):
    """A load acts on a face that a condition holds by Nitsche's method."""


class BuriedLoadWarning(DolfinMPMWarning):
    """A load on a boundary acts within the body, with material points on both sides."""


class DegreesWarning(DolfinMPMWarning):
    """An angle may be in radians instead of degrees, or the reverse."""


class WideComparisonWarning(DolfinMPMWarning):
    """A function of places compares map coordinates by a tolerance that is as wide as the body."""


class DifferentProblemWarning(DolfinMPMWarning):
    """A checkpoint goes on in a problem with other laws, bases, stabilisations or conditions."""


class DoubtfulInputWarning(DolfinMPMWarning):
    """An input is far from usual ones: its unit may be another, or it may count twice."""


class DriftingRecordWarning(DolfinMPMWarning):
    """A recorded motion does not come to rest at its end, or steps pass over its waves."""


class LongPiecesWarning(DolfinMPMWarning):
    """The pieces of a boundary are longer than the leaves of a refined space there."""


class LocalValueWarning(DolfinMPMWarning):
    """A recorded number differs between ranks, and rank 0's number is written."""


class LostMomentumWarning(DolfinMPMWarning):
    """A mass cut-off is so large that nodes that stand still may stop a body."""


class SectionAtEndWarning(DolfinMPMWarning):
    """A section is so near to the end of a body that its forces are those of a part of a slab."""


class SingularMassWarning(DolfinMPMWarning):
    """A consistent mass is nearly singular: its nodal velocities are far too large."""


class OverlapWarning(DolfinMPMWarning):
    """Corners of points begin deep within a rigid body, which pushes them out."""


class SmallBodyWarning(DolfinMPMWarning):
    """A rigid body is smaller than the points' domains, and passes between their corners."""


class RoughShapeWarning(DolfinMPMWarning):
    """The points of a filled shape have a volume that is far from that of the shape."""


class SoftVolumeWarning(DolfinMPMWarning):
    """F-bar leaves too little volumetric stiffness for the law."""


class UnstablePairWarning(DolfinMPMWarning):
    """Displacement and pore pressure are of equal order, without stabilisation."""


class UnreadOptionWarning(DolfinMPMWarning):
    """No solver has read a given option of PETSc."""


class ImbalanceWarning(DolfinMPMWarning):
    """A rank has far more material points than other ranks."""


def warn(comm: MPI.Comm, message: str, category: type[DolfinMPMWarning]) -> None:
    """Warn on rank 0, at the line of the user's script.

    Args:
        comm: Communicator of the ranks.
        message: The message.
        category: Class of the warning.
    """
    if comm.rank != 0:
        return
    level = 1
    frame = sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        frame, level = frame.f_back, level + 1
    if not _unseen():
        warnings.warn(message, category, stacklevel=level)
        return
    logging.captureWarnings(False)
    try:
        warnings.warn(message, category, stacklevel=level)
    finally:
        logging.captureWarnings(True)


def _unseen() -> bool:
    """Whether warnings go to a logger that shows them to nobody: the import of FFCx does this."""
    if warnings.showwarning.__module__ != "logging":
        return False
    handlers = logging.getLogger("py.warnings").handlers + logging.getLogger().handlers
    return all(isinstance(handler, logging.NullHandler) for handler in handlers)


def call_together(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call a function that may raise on some ranks only; then all ranks raise. Collective.

    Args:
        comm: Communicator whose ranks all make this call.
        function: The function; it makes no collective calls itself.
    """
    error, result = None, None
    try:
        result = function()
    except Exception as caught:
        error = caught
    raise_together(comm, error)
    return result  # type: ignore[return-value]


def call_on_root(comm: MPI.Comm, function: Callable[[], Result]) -> Result:
    """Call a function on rank 0 alone; all ranks get its result, or raise its error. Collective.

    Args:
        comm: The ranks.
        function: The function.
    """

    def act() -> Any:
        return function() if comm.rank == 0 else None

    return comm.bcast(call_together(comm, act))


def raise_together(comm: MPI.Comm, error: Exception | None) -> None:
    """Raise on every rank if any rank has an error. Collective.

    Args:
        comm: Communicator whose ranks all make this call.
        error: This rank's error, or None.

    Raises:
        Exception: This rank's error. Ranks without an error raise an error with the class and the
            message of the lowest failing rank.
    """
    if comm.size == 1:
        if error is not None:
            raise error
        return
    lowest = np.array([comm.rank if error is not None else comm.size])
    # a reduction of an array takes a quarter of the time of a Python number
    comm.Allreduce(MPI.IN_PLACE, lowest, op=MPI.MIN)
    failing = int(lowest[0])
    if failing == comm.size:
        return
    first = (type(error), str(error)) if comm.rank == failing else None
    kind, message = comm.bcast(first, root=failing)
    if error is None:
        try:
            error = kind(message)
        except TypeError:  # some exceptions of other packages take more arguments
            error = DolfinMPMError(f"{kind.__name__}: {message}")
    error.__dict__[_COMMON] = f"{kind.__name__}: {message}"
    raise error


def common_text(error: BaseException) -> str | None:
    """Class and message that all ranks have in common for an error raised together, or None."""
    return error.__dict__.get(_COMMON)
