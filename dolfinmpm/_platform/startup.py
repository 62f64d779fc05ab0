"""What must be done once, before any compiled loop is loaded; the package imports it first."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

from dolfinx import __version__
from mpi4py import MPI
from petsc4py import PETSc  # noqa: F401  it takes signals when it starts

__all__ = ["NEWEST", "OLDEST", "check_version"]

OLDEST, NEWEST = (0, 9), (0, 11)  # that the tests have passed on


def check_version(version: str, rank: int) -> None:
    """Refuse a DOLFINx that is too old, and warn of one that is newer than what was tried.

    Args:
        version: DOLFINx's own, such as "0.11.0.post0".
        rank: Of this process; only rank 0 warns.

    Raises:
        ImportError: It is older than `OLDEST`.
    """
    found = re.match(r"(\d+)\.(\d+)", version)
    numbers = (int(found[1]), int(found[2])) if found else NEWEST
    oldest, newest = (".".join(map(str, one)) for one in (OLDEST, NEWEST))
    if numbers < OLDEST:
        raise ImportError(
            f"dolfinmpm needs DOLFINx {oldest} or newer, and this is {version}: install "
            "fenics-dolfinx from conda-forge, python3-dolfinx-real from Debian 13 or Ubuntu 26.04, "
            "or start the command by docker/run"
        )
    if numbers > NEWEST and rank == 0:
        warnings.warn(
            f"DOLFINx {version} is newer than {newest}, the last one that dolfinmpm was tested on: "
            "run its tests before you trust figures",
            stacklevel=2,
        )


check_version(__version__, MPI.COMM_WORLD.rank)

from dolfinmpm._platform.brokenpipe import end_quietly
from dolfinmpm._platform.compat import kernel_arguments
from dolfinmpm._platform.kernelcache import forget_outdated
from dolfinmpm._platform.watchdog import watch

forget_outdated(Path(__file__).parents[1], f"kernels of {kernel_arguments()} arguments")
watch(MPI.COMM_WORLD)
end_quietly()
