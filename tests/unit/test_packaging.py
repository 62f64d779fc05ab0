"""Lists of packages, versions and scripts of all ways to install agree."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import dolfinmpm as mpm

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# DOLFINx and what it is built with: not to be had from PyPI
BUILT_TOGETHER = {"fenics-dolfinx", "mpi4py", "petsc4py", "slepc4py"}
# names of Debian and conda-forge that differ from those on PyPI
DEBIAN = {"fenics-dolfinx": "python3-dolfinx-real", "vtk": "python3-vtk9"}
CONDA = {"matplotlib": "matplotlib-base"}
# what installs the package; what Debian does not have, or the tests take from PyPI
INSTALLERS = {"pip", "setuptools", "wheel"}
NOT_IN_DEBIAN = {"openturns", "ruff"}


def split(requirement):
    """Name of a requirement, and the least version as text, if any."""
    name, least = re.fullmatch(r"([\w.-]+) *(?:>=([\d.]+))?", requirement).groups()
    return name, least


def lines(path, start=""):
    """What a file lists, one per line, without comments."""
    text = [line.split(" #")[0].strip() for line in path.read_text().splitlines()]
    return [x.removeprefix(start) for x in text if x.startswith(start) and x and x[0] != "#"]


EXTRAS = PROJECT["optional-dependencies"]
WITHOUT_TESTS = dict(
    map(split, sum((EXTRAS[x] for x in EXTRAS if x != "test"), PROJECT["dependencies"]))
)
EVERYTHING = dict(map(split, EXTRAS["test"])) | WITHOUT_TESTS


def conda_lists():
    """Requirements of environment.yml, and of the recipe's section of what it runs on."""
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    run = re.search(r"\n  run:\n(.*?)\n\n", recipe, re.DOTALL).group(1)
    return {
        "environment": lines(ROOT / "environment.yml", "- "),
        "recipe": [x.strip().removeprefix("- ") for x in run.splitlines() if "#" not in x],
    }


@pytest.mark.parametrize(
    ("where", "wanted"), [("environment", EVERYTHING), ("recipe", WITHOUT_TESTS)]
)
def test_conda_has_the_names_and_versions_of_the_project(where, wanted):
    given = {}
    for item in conda_lists()[where]:
        name, _, least = item.replace(">=", " ").partition(" ")
        given[name.split("=")[0]] = least.strip() or None
    for name, least in wanted.items():
        assert given.get(CONDA.get(name, name), "missing") == least


def test_debian_has_the_names_of_the_project():
    packages = set(lines(ROOT / "docker/packages.txt"))
    for name in EVERYTHING.keys() - NOT_IN_DEBIAN - {"numpy"}:  # SciPy brings NumPy
        assert DEBIAN.get(name, f"python3-{name}") in packages


def test_pypi_list_is_the_project_without_what_is_built_together():
    listed = dict(map(split, lines(ROOT / "docker/requirements.txt")))
    wanted = EVERYTHING.keys() - BUILT_TOGETHER - NOT_IN_DEBIAN
    assert listed.keys() - INSTALLERS == wanted
    assert all(listed[name] == EVERYTHING[name] for name in wanted)


def test_one_version():
    citation = (ROOT / "CITATION.cff").read_text()
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    assert re.search(r"^version: (.*)$", citation, re.MULTILINE).group(1) == mpm.__version__
    assert re.search(r"^  version: (.*)$", recipe, re.MULTILINE).group(1) == mpm.__version__
    assert f"## {mpm.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_authors_and_keywords_are_those_of_the_citation():
    citation = (ROOT / "CITATION.cff").read_text()
    for author in PROJECT["authors"]:
        assert f'name: "{author["name"]}"' in citation
    for word in PROJECT["keywords"]:
        assert f"  - {word}\n" in citation


def test_what_the_docs_name_is_there():
    for page in ("README.md", "docs/install.md", "CONTRIBUTING.md"):
        text = (ROOT / page).read_text()
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
            if "://" not in link:
                assert (ROOT / page).parent.joinpath(link).exists(), f"{page} names {link}"
        for path in re.findall(r"\b(?:packaging|docker|docs)/[\w./]+\w(?![\w*])", text):
            if not path.startswith("docs/_build/"):  # made by docs/build
                assert (ROOT / path).exists(), f"{page} names {path}"


@pytest.mark.parametrize("script", ["docker/run", ".ci/run", "packaging/slurm.sh"])
def test_scripts_parse(script):
    path = ROOT / script
    if not path.exists():
        pytest.skip("an sdist has no .ci")
    subprocess.run(["bash", "-n", path], check=True)
    assert os.access(path, os.X_OK)


def docker_run(*args, **variables):
    return subprocess.run(
        [ROOT / "docker/run", *args], env=os.environ | variables, capture_output=True, text=True
    )


def test_an_unknown_release_is_refused_with_those_that_are_known():
    done = docker_run("true", DOLFINMPM_DEBIAN="bookworm")
    assert done.returncode == 125
    assert "bookworm" in done.stderr
    assert "trixie, sid" in done.stderr


def test_release_and_image_exclude_each_other():
    done = docker_run("true", DOLFINMPM_DEBIAN="sid", DOLFINMPM_IMAGE="dolfinx/dolfinx:stable")
    assert done.returncode == 125
    assert "DOLFINMPM_IMAGE" in done.stderr


def test_help_names_all_variables():
    text = docker_run("--help").stdout
    for name in ("DOLFINMPM_CACHE", "DOLFINMPM_DEBIAN", "DOLFINMPM_IMAGE", "30 days"):
        assert name in text


def test_a_run_that_is_stopped_goes_on_from_its_checkpoint(tmp_path):
    """The script that the job of Slurm starts, stopped in its tenth step."""
    stop = (
        "import runpy, sys, dolfinmpm as mpm\n"
        "step = mpm.QuasiStatic.step\n"
        "def some(problem):\n"
        "    if len(problem.history) == 9:\n"
        "        sys.exit(3)\n"
        "    return step(problem)\n"
        "mpm.QuasiStatic.step = some\n"
        "runpy.run_path(sys.argv[1])\n"
    )
    script = str(ROOT / "packaging/restart.py")

    def run(name, *command):
        env = os.environ | {"CHECKPOINT": str(tmp_path / name)}
        return subprocess.run([sys.executable, *command], env=env, capture_output=True, text=True)

    assert run("stopped.npz", "-c", stop, script).returncode == 3
    gone_on, whole = run("stopped.npz", script), run("whole.npz", script)
    assert gone_on.stdout.startswith("31 of 40 steps"), gone_on.stderr
    assert whole.stdout.startswith("40 of 40 steps"), whole.stderr
    assert gone_on.stdout.split(";")[1] == whole.stdout.split(";")[1]
