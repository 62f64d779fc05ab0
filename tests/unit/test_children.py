"""What a test starts ends with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import start

LEAVES_A_CHILD = """
import subprocess
quiet = subprocess.DEVNULL
options = {"stdin": quiet, "stdout": quiet, "stderr": quiet, "process_group": GROUP}
child = subprocess.Popen(["sleep", "3600"], **options)
print(child.pid, flush=True)
"""


def runs(process):
    """Whether a process is there and not only waiting to be buried."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("group", ["None", "0"])
def test_what_a_script_leaves_behind_ends(tmp_path, group):
    """In the script's own process group, and in one that it made."""
    script = tmp_path / "script.py"
    script.write_text(LEAVES_A_CHILD.replace("GROUP", group))
    done = start(script)
    assert done.returncode == 0
    assert not runs(int(done.stdout))
