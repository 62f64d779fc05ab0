"""Run studies at a small size on the ranks of this process, one after the other, with pictures.

    docker/run mpirun -n 2 python3 -m mpi4py .ci/studies.py FOLDER [NAME ...]

All of them share one interpreter per rank, whose imports are paid for once. What is checked is
that each comes to its end; the tests check figures. One study stands for those that take the same
way over the ranks.
"""

from __future__ import annotations

import shlex
import signal
import sys
import time
from pathlib import Path

from mpi4py import MPI

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from conftest import run_here

# seconds that one study may take
LIMIT = 1800
# the tests have two ranks of `plate_on_cube` and `hertz_bodies`, with pictures
STUDIES = """
column_compaction --elements 8
conditioning --offsets 3
ghost_parameter --depths 2 --factors 0.01,0.1
solid_3d --cells 6,8
manufactured_solution --basis gimp --cells 4,8 --scene cut
elastoplastic_collapse --points-per-cell 3 --steps 10
thick_cylinder --h 0.025 --steps 12 --basis gimp --stabilisation ghost
cavity_expansion --shape sphere --law tresca --h 0.5 --ratio 1.02 --steps 2
circular_footing --h 0.1 --width 3 --depth 2 --steps 6
round_collapse --h 0.02 --duration 1
incline --duration 0.05
hertz --resolution 3
retaining_wall --h 0.1
consolidation --h 0.125 --steps 20
consolidation --pair nested --h 0.125 --steps 10
inf_sup --places 3 --uncut 4 --pairs nested,linear-linear-projected --stabilisations none,ghost
mandel --cells 8 --steps 20
footing_3d --cells 6 --steps 1
coupled_slope --law cam-clay --h 1 --steps 10
vibrating_bar --duration 5
colliding_discs --h 0.1
stability_atlas --first 40 --stabilisation ghost,aggregation --strict
column_collapse --h 0.04 --duration 0.1 --times 0.05
slope_runout --h 1 --duration 0.3 --dt 0.05
explicit_speed --points 4000 --repeat 1 --bases bspline2,gimp
"""


def main(folder: str, names: list[str]) -> None:
    """Run all studies, or those of some names."""
    for line in STUDIES.strip().splitlines():
        name, *options = shlex.split(line)
        if names and name not in names:
            continue
        started = time.perf_counter()
        if MPI.COMM_WORLD.rank == 0:
            print(f"study {line}", flush=True)
        signal.alarm(LIMIT)
        run_here(ROOT / "demos" / "studies" / f"{name}.py", [*options, "--output", folder])
        signal.alarm(0)
        if MPI.COMM_WORLD.rank == 0:
            print(f"    {time.perf_counter() - started:.1f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
