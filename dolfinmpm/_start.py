"""What must be done once, before any compiled loop is loaded; the package imports it first."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from dolfinmpm.abort import end_all_ranks
from dolfinmpm.kernelcache import forget_outdated

forget_outdated(Path(__file__).parent)
end_all_ranks(MPI.COMM_WORLD)
