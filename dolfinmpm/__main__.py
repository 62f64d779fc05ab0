"""`python3 -m dolfinmpm` prints what a bug report has to tell."""

from mpi4py import MPI

from dolfinmpm._platform.installation import info

if __name__ == "__main__":
    report = info()
    if MPI.COMM_WORLD.rank == 0:
        print(report)
