"""Loops that call what has changed in another file are compiled again."""

from __future__ import annotations

import os
import subprocess
import sys

from dolfinmpm._platform.kernelcache import forget_outdated

CALLEE = "import numba\n@numba.njit(cache=True)\ndef value():\n    return {}\n"
CALLER = (
    "import numba\nfrom callee import value\n"
    "@numba.njit(cache=True)\ndef twice():\n    return 2 * value()\n"
)


LAW = """
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Parameter
from factor import FACTOR
STIFFNESS = FACTOR * (1.0 if __name__ == "__main__" else 10.0)
@law_kernel
def kernel(parameters, strain, old, new, stress, tangent):
    for i in range(3):
        stress[i] = STIFFNESS * parameters[0] * strain[i]
        for j in range(3):
            tangent[3 * i + j] = STIFFNESS * parameters[0] * (i == j)
    return 0
class Linear(Law):
    parameters = {"E": Parameter("Pa", low=0.0)}
    kernel = kernel
def answer():
    return round(Linear(E=2.0).respond([[1.0, 0.0, 0.0]]).stress[0, 0])
if __name__ == "__main__":
    print(answer())
"""


def twice(folder):
    code = "from caller import twice; print(twice())"
    command = [sys.executable, "-c", code]
    return int(subprocess.run(command, cwd=folder, capture_output=True, check=True).stdout)


def test_a_changed_callee_is_seen(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(1))
    assert forget_outdated(tmp_path)
    assert twice(tmp_path) == 2
    assert not forget_outdated(tmp_path)
    indices = list(tmp_path.rglob("*.nbi"))
    assert indices
    (tmp_path / "callee.py").write_text(CALLEE.format(21))
    assert forget_outdated(tmp_path)
    assert not any(index.exists() for index in indices)
    assert twice(tmp_path) == 42
    assert not forget_outdated(tmp_path)


def test_a_law_of_a_script_is_compiled_under_each_of_its_names(tmp_path):
    """One file as a script and as a module, and with another number from a second file."""
    (tmp_path / "law.py").write_text(LAW)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    asked = ["law.py"], ["-c", "import law; print(law.answer())"]

    def answers():
        return [
            int(subprocess.run([sys.executable, *how], cwd=tmp_path, env=environment,
                               capture_output=True, check=True).stdout)
            for how in (*asked, asked[0])
        ]  # fmt: skip

    for factor in (1, 3):
        (tmp_path / "factor.py").write_text(f"FACTOR = {factor}.0  # {'.' * factor}\n")
        assert answers() == [2 * factor, 20 * factor, 2 * factor]


def test_other_files_do_not_count(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    assert forget_outdated(tmp_path)
    (tmp_path / "plain.py").write_text("x = 1\n")
    assert not forget_outdated(tmp_path)
