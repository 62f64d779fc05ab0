"""Distributions of parameters. OpenTURNS is imported where it is used."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_dictionary, number, shown
from dolfinmpm._platform.errors import MissingPackageError, ParameterError
from dolfinmpm._platform.uncopied import unchanged

__all__ = ["LogNormal", "Normal", "checked", "openturns"]

Array = npt.NDArray[np.float64]
# Bound of a coefficient of variation, as in `RandomField`: 30 is 30 %, written as a number
_LARGEST = 10.0


def openturns() -> Any:
    """OpenTURNS.

    Raises:
        MissingPackageError: It is not installed.
    """
    flags = sys.getdlopenflags()
    # its wheel has an HDF5 of its own, which must not take the symbols of the one of DOLFINx
    sys.setdlopenflags(flags | getattr(os, "RTLD_DEEPBIND", 0))
    try:
        import openturns as library
    except ImportError:
        raise MissingPackageError(
            "reliability needs OpenTURNS, which is not installed: python3 -m pip install "
            "openturns, apt-get install python3-openturns, or conda install -c conda-forge "
            "openturns"
        ) from None
    finally:
        sys.setdlopenflags(flags)
    return library


@unchanged()
@dataclass(frozen=True)
class Normal:
    """A normal distribution of a parameter.

    Args:
        mean: Mean.
        deviation: Standard deviation, in the same unit.

    >>> import dolfinmpm as mpm
    >>> mpm.study.Normal(30.0, 2.0).middle
    30.0
    """

    mean: float = 0.0
    deviation: float = 1.0

    def __post_init__(self) -> None:
        number("mean", self.mean)
        number("deviation", self.deviation, 0.0)

    @property
    def middle(self) -> float:
        """The median."""
        return self.mean

    def at(self, z: Array) -> Array:
        """Values at standard normal ones."""
        return self.mean + self.deviation * z

    def made(self) -> Any:
        """The distribution of OpenTURNS."""
        return openturns().Normal(self.mean, self.deviation)


@unchanged()
@dataclass(frozen=True)
class LogNormal:
    """A lognormal distribution of a parameter.

    Args:
        mean: Mean.
        coefficient: Coefficient of variation.

    >>> import dolfinmpm as mpm
    >>> round(mpm.study.LogNormal(20e3, 0.3).middle)
    19157
    """

    mean: float
    coefficient: float

    def __post_init__(self) -> None:
        number("mean", self.mean, 0.0)
        number("coefficient", self.coefficient, 0.0, _LARGEST)

    @property
    def middle(self) -> float:
        """The median."""
        return self.mean / math.sqrt(1 + self.coefficient**2)

    @property
    def _spread(self) -> float:
        """Standard deviation of the logarithm."""
        return math.sqrt(math.log1p(self.coefficient**2))

    def at(self, z: Array) -> Array:
        """Values at standard normal ones."""
        return np.asarray(self.middle * np.exp(self._spread * z))

    def made(self) -> Any:
        """The distribution of OpenTURNS."""
        return openturns().LogNormal(math.log(self.middle), self._spread, 0.0)


def checked(distributions: Any) -> dict[str, Callable[[Array], Array]]:
    """Functions that return values of the parameters at standard normal ones, by name.

    Args:
        distributions: Name → `Normal`, `LogNormal`, or a distribution of OpenTURNS.

    Raises:
        ParameterError: It is no dictionary of distributions.
    """
    check_dictionary("distributions", distributions, " of distributions by name", some=True)
    return {name: _values(name, given) for name, given in distributions.items()}


def _values(name: str, given: Any) -> Callable[[Array], Array]:
    if isinstance(given, (Normal, LogNormal)):
        return given.at
    if not hasattr(given, "computeQuantile"):
        raise ParameterError(
            f"distributions['{name}'] = {shown(given)} must be a study.Normal, a study.LogNormal, "
            "or a distribution of OpenTURNS"
        )
    if (size := given.getDimension()) != 1:
        raise ParameterError(
            f"distributions['{name}'] is one of {size} numbers, and must be one of a single "
            "number: give each parameter its own distribution; let the scene make correlated ones "
            "of independent study.Normal() z1 and z2, such as "
            "a = mean + deviation * (r * z1 + sqrt(1 - r**2) * z2)"
        )

    def quantiles(z: Array) -> Array:
        from scipy.special import ndtr

        return np.array([given.computeQuantile(float(p))[0] for p in ndtr(z)])

    return quantiles
