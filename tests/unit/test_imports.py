"""What `import dolfinmpm` loads: nothing that a scene may not use."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from dolfinmpm._platform.garbagecollector import idle_collector


def test_libraries_that_few_scenes_use_are_loaded_by_these():
    names = "scipy.sparse", "scipy.spatial", "scipy.linalg", "matplotlib", "h5py", "meshio"
    names += ("dolfinmpm.study",)
    code = f"import sys, dolfinmpm; print([n for n in {names} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def printed(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_modules_are_out_of_collections_but_what_is_made_later_is_not():
    code = """
import gc, weakref, dolfinmpm
class Cycle: pass
one = Cycle(); one.self = one; last = weakref.ref(one); del one
gc.collect()
print(gc.isenabled(), gc.get_freeze_count() > 100_000, last() is None)
"""
    assert printed(code) == ["True", "True", "True"]


def test_in_an_interactive_session_nothing_is_left_out():
    code = "import gc, sys; sys.ps1 = ''; import dolfinmpm; print(gc.get_freeze_count())"
    assert printed(code) == ["0"]


@pytest.mark.parametrize("enabled", [True, False])
def test_a_failed_import_leaves_the_collector_as_it_was(enabled):
    def fail():
        with idle_collector():
            assert not gc.isenabled()
            raise ImportError

    frozen = gc.get_freeze_count()
    if not enabled:
        gc.disable()
    try:
        with pytest.raises(ImportError):
            fail()
        assert gc.isenabled() == enabled
        assert gc.get_freeze_count() == frozen
    finally:
        gc.enable()
