"""What `import dolfinmpm` loads: nothing that a scene may not use."""

from __future__ import annotations

import subprocess
import sys


def test_libraries_that_few_scenes_use_are_loaded_by_these():
    names = "scipy.sparse", "scipy.spatial", "scipy.linalg", "matplotlib", "h5py", "meshio"
    code = f"import sys, dolfinmpm; print([n for n in {names} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
