"""What must be done once, before any compiled loop is loaded; the package imports it first."""

from __future__ import annotations

from pathlib import Path

from dolfinx import __version__
from mpi4py import MPI
from petsc4py import PETSc  # noqa: F401  it takes signals when it starts

from dolfinmpm._platform.versions import check_version

check_version(__version__, MPI.COMM_WORLD.rank)

from dolfinmpm._platform.brokenpipe import end_quietly
from dolfinmpm._platform.compat import kernel_arguments
from dolfinmpm._platform.kernelcache import forget_outdated
from dolfinmpm._platform.watchdog import watch

forget_outdated(Path(__file__).parents[1], f"kernels of {kernel_arguments()} arguments")
watch(MPI.COMM_WORLD)
end_quietly()
