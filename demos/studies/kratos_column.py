"""The compacting column in Kratos Multiphysics' material point method, for comparison.

`pip install KratosMPMApplication KratosLinearSolversApplication` has it. Its law is neo-Hookean
where ours is Hencky's, which it has for yielding bodies only; the stresses are the same, since
equilibrium of a column under its weight gives them whatever the law. Bilinear functions, 2² points
a cell, the same load steps, the same relative residual, factors of a sparse LU.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

HEIGHT, E, DENSITY, GRAVITY = 50.0, 1e4, 80.0, 10.0


def mesh_file(path, columns, elements, element, shift, part, sides):
    """A rectangle of quadrilaterals as Kratos reads it."""
    h, across = HEIGHT / elements, columns + 1

    def node(i, j):
        return j * across + i + 1 + shift

    nodes = [(node(i, j), i * h, j * h) for j in range(elements + 1) for i in range(across)]
    cells = [
        (node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1))
        for j in range(elements) for i in range(columns)
    ]  # fmt: skip
    names = {
        "SIDES": [node(i, j) for j in range(elements + 1) for i in (0, columns)],
        "BASE": [node(i, 0) for i in range(across)],
    }
    lines = ["Begin ModelPartData", "End ModelPartData"]
    for number in (0, 1):
        lines += [f"Begin Properties {number}", "End Properties"]
    lines += ["Begin Nodes", *(f"{n} {x:.12g} {y:.12g} 0.0" for n, x, y in nodes), "End Nodes"]
    rows = [f"{k + 1 + shift} 1 {' '.join(map(str, c))}" for k, c in enumerate(cells)]
    lines += [f"Begin Elements {element}", *rows, "End Elements"]
    parts = {part: ([n for n, *_ in nodes], [k + 1 + shift for k in range(len(cells))])}
    if sides:
        parts |= {name: (found, []) for name, found in names.items()}
    for name, (inside, elements_inside) in parts.items():
        lines += [f"Begin SubModelPart {name}", "Begin SubModelPartNodes", *map(str, inside)]
        lines += ["End SubModelPartNodes", "Begin SubModelPartElements"]
        lines += [*map(str, elements_inside), "End SubModelPartElements", "End SubModelPart"]
    Path(path).write_text("\n".join(lines) + "\n")


def held(part, which):
    """A condition that holds some components at zero."""
    return {
        "python_module": "assign_vector_variable_process",
        "kratos_module": "KratosMultiphysics",
        "Parameters": {
            "model_part_name": f"Background_Grid.{part}", "variable_name": "DISPLACEMENT",
            "constrained": which, "value": [0.0 if w else None for w in which],
            "interval": [0.0, "End"],
        },
    }  # fmt: skip


def settings(steps):
    """Kratos' parameters."""
    return {
        "problem_data": {
            "problem_name": "column", "parallel_type": "OpenMP", "echo_level": 0,
            "start_time": 0.0, "end_time": 1.0 - 1e-9,
        },
        "solver_settings": {
            "solver_type": "Static", "model_part_name": "MPM_Material", "domain_size": 2,
            "echo_level": 0, "analysis_type": "non_linear", "pressure_dofs": False,
            "model_import_settings": {"input_type": "mdpa", "input_filename": "Body"},
            "material_import_settings": {"materials_filename": "Material.json"},
            "time_stepping": {"time_step": 1.0 / steps},
            "convergence_criterion": "residual_criterion",
            "residual_relative_tolerance": 1e-9, "residual_absolute_tolerance": 1e-9,
            "max_iteration": 20,
            "grid_model_import_settings": {"input_type": "mdpa", "input_filename": "Grid"},
            "linear_solver_settings": {
                "solver_type": "LinearSolversApplication.sparse_lu", "scaling": False,
            },
        },
        "processes": {
            "constraints_process_list": [
                held("SIDES", [True, False, True]), held("BASE", [False, True, True]),
            ],
            "gravity": [],
        },
        "output_processes": {},
    }  # fmt: skip


def solve(columns, elements, steps):
    """Solve the column in the current folder; returns the figures."""
    import KratosMultiphysics as Kratos
    import KratosMultiphysics.LinearSolversApplication
    import KratosMultiphysics.MPMApplication as Points
    from KratosMultiphysics.MPMApplication.mpm_analysis import MPMAnalysis

    Kratos.Logger.GetDefaultOutput().SetSeverity(Kratos.Logger.Severity.WARNING)
    count = (columns + 1) * (elements + 1)
    mesh_file("Grid.mdpa", columns, elements, "Element2D4N", 0, "Parts_Grid", True)
    body = "MPMUpdatedLagrangian2D4N"
    mesh_file("Body.mdpa", columns, elements, body, 10 * count, "Parts_Body", False)
    values = {
        "THICKNESS": 1.0, "MATERIAL_POINTS_PER_ELEMENT": 4, "DENSITY": DENSITY,
        "YOUNG_MODULUS": E, "POISSON_RATIO": 0.0,
    }  # fmt: skip
    material = {
        "model_part_name": "Initial_MPM_Material.Parts_Body", "properties_id": 1,
        "Material": {
            "constitutive_law": {"name": "HyperElasticNeoHookeanPlaneStrain2DLaw"},
            "Variables": values, "Tables": {},
        },
    }  # fmt: skip
    Path("Material.json").write_text(json.dumps({"properties": [material]}))

    class Column(MPMAnalysis):
        """Steps of gravity."""

        step = iterations = 0

        def InitializeSolutionStep(self):
            self.step += 1
            part = self._GetSolver().GetComputingModelPart()
            weight = Kratos.Vector(3)
            weight[0], weight[1], weight[2] = 0.0, -GRAVITY * self.step / steps, 0.0
            for element in part.Elements:
                element.SetValuesOnIntegrationPoints(
                    Points.MP_VOLUME_ACCELERATION, [weight], part.ProcessInfo
                )
            super().InitializeSolutionStep()

        def FinalizeSolutionStep(self):
            super().FinalizeSolutionStep()
            solver = self._GetSolver()
            parts = solver.GetComputingModelPart(), solver.GetGridModelPart()
            number = Kratos.NL_ITERATION_NUMBER
            self.iterations += max(part.ProcessInfo[number] for part in parts)

    run = Column(Kratos.Model(), Kratos.Parameters(json.dumps(settings(steps))))
    run.Initialize()
    points = run._GetSolver().GetComputingModelPart()

    def each(variable):
        info = points.ProcessInfo
        return [e.CalculateOnIntegrationPoints(variable, info)[0] for e in points.Elements]

    first, volume = [x[1] for x in each(Points.MP_COORD)], each(Points.MP_VOLUME)
    started, processor = time.perf_counter(), time.process_time()
    run.RunSolutionLoop()
    seconds, processor = time.perf_counter() - started, time.process_time() - processor
    stress = [s[1] for s in each(Points.MP_CAUCHY_STRESS_VECTOR)]
    weight = DENSITY * GRAVITY
    off = sum(abs(s + weight * (HEIGHT - y)) * V for s, y, V in zip(stress, first, volume))
    return {
        "error": off / (weight * HEIGHT * sum(volume)),
        "seconds": processor,
        "seconds_wall": seconds,
        "iterations": run.iterations,
        "steps": run.step,
        "points": len(first),
    }


if __name__ == "__main__":
    options = argparse.ArgumentParser(description="The compacting column in Kratos.")
    options.add_argument("--columns", type=int, default=1)
    options.add_argument("--elements", type=int, default=64)
    options.add_argument("--steps", type=int, default=40)
    args = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        figures = solve(args.columns, args.elements, args.steps)
        os.chdir("/")
    print(json.dumps(figures), flush=True)
