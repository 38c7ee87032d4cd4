"""The wheel, in an environment of its own and outside the checkout: every command works there.

So it does where it was built without a C compiler, and there a chosen part of the tests runs, too.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: What a build needs of the checkout.
SOURCES = ("certpgo", "pyproject.toml", "README.md", "LICENSE")
LOOP = tuple(
    "EDGE_SE2 {} {} 1 0 1.57 25 0 0 25 0 100\n".format(*pair)
    for pair in ((0, 1), (1, 2), (2, 3), (3, 0))
)


#: What is tried without the kernel: readers, factorizations, sums, covariances, verdicts, proofs.
CHOSEN = (
    "io/test_fields.py",
    "io/test_exact_weights.py",
    "graph/test_trees.py",
    "linalg/test_factor.py",
    "linalg/test_selected_inverse.py",
    "linalg/test_balls.py",
    "linalg/test_blocks.py",
    "optimize/test_spectral.py",
    "optimize/test_marginals.py",
    "cli/test_follow_command.py",
    "cli/test_prove_command.py",
)


def run(*command, cwd=None, expected=0, **variables):
    # Nothing of the environment leads to the checkout.
    leading = ("PYTHON", "PYTEST_", "CERTPGO_", "PIP_")
    own = {k: v for k, v in os.environ.items() if not k.startswith(leading)} | variables
    done = subprocess.run(
        [str(word) for word in command], cwd=cwd, env=own, capture_output=True, text=True
    )
    assert done.returncode == expected, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder of the programs of an environment with the wheel."""
    return environment_in(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def without_compiler(tmp_path_factory):
    """The same, of a wheel that was built where every C compiler fails."""
    return environment_in(tmp_path_factory.mktemp("without-compiler"), CC="false")


def environment_in(folder, **variables):
    """The folder of the programs of an environment with a wheel, built with these variables."""
    source = folder / "source"
    source.mkdir()
    ignored = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
    for name in SOURCES:
        given, copy = ROOT / name, source / name
        if given.is_dir():
            shutil.copytree(given, copy, ignore=ignored)
        else:
            shutil.copy(given, copy)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    built = subprocess.run(
        [*pip, "wheel", "--no-deps", "--wheel-dir", folder, source],
        env=os.environ | variables,
        capture_output=True,
        text=True,
    )
    if "No matching distribution found for setuptools" in built.stderr:
        pytest.skip("setuptools, which builds wheels, can neither be found nor downloaded")
    assert built.returncode == 0, built.stderr
    (wheel,) = folder.glob("certpgo-*.whl")
    environment = folder / "environment"
    run(sys.executable, "-m", "venv", "--without-pip", environment)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    run(*pip, "--python", programs / "python", "install", "--no-deps", "--no-index", wheel)
    # What it depends on is that of this environment; a .pth file there, which would lead to the
    # checkout, is not followed from here.
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(run(programs / "python", "-c", where).strip())
    known = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    # Where this environment takes packages from another one, that one too.
    known |= {path for path in sys.path if path.endswith("site-packages")}
    (site / "dependencies.pth").write_text("".join(f"{path}\n" for path in sorted(known)))
    return programs


@pytest.mark.slow
@pytest.mark.parametrize("environment", ["installed", "without_compiler"])
def test_the_commands_work_from_a_wheel(environment, request, tmp_path):
    installed = request.getfixturevalue(environment)
    # Formats are found by scanning the installed folder.
    where = "import certpgo.io.format as f; print(f.__file__); print(*f.formats())"
    found, formats = run(installed / "python", "-c", where, cwd=tmp_path).splitlines()
    assert installed.parent in Path(found).parents
    assert {"g2o", "open3d", "rosbag"} <= {*formats.split()}
    (tmp_path / "loop.g2o").write_text("".join(LOOP))

    def certpgo(*words, **more):
        return run(installed / "certpgo", *words, cwd=tmp_path, **more)

    kernel = {
        row["name"]: row["here"]
        for row in json.loads(certpgo("list", "engines", "--json"))["engines"]
    }["multifrontal"]
    assert kernel.startswith("yes" if environment == "installed" else "no: installed without a C")
    assert "poses in 2D" in certpgo("info", "loop.g2o")
    chordal = ("--cost", "chordal")
    solved = ("solve", "loop.g2o", *chordal, "-o", "out.g2o", "--proof", "out.cert")
    assert "CERTIFIED" in certpgo(*solved)
    assert certpgo("certify", "loop.g2o", "out.g2o", *chordal).startswith("CERTIFIED")
    assert certpgo("check", "loop.g2o", "out.cert").startswith("PROVED")
    methods = "certified,spanning_tree"
    compared = certpgo("compare", "loop.g2o", *chordal, "--methods", methods, "--json")
    assert {row["verdict"] for row in json.loads(compared)} >= {"CERTIFIED"}


@pytest.mark.slow
def test_chosen_tests_pass_without_a_compiler(without_compiler, tmp_path):
    tests = [ROOT / "tests" / name for name in CHOSEN]
    # -o: the checkout, whose kernel may be compiled, is not on the path.
    options = (
        "-p",
        "no:cacheprovider",
        "-o",
        "pythonpath=tests",
        "--basetemp",
        tmp_path / "own",
    )
    data = {k: v for k, v in os.environ.items() if k == "CERTPGO_DATA"}
    python = without_compiler / "python"
    said = run(python, "-m", "pytest", *options, *tests, cwd=ROOT, PYTHONSAFEPATH="1", **data)
    assert " passed" in said.splitlines()[-1]


@pytest.mark.slow
def test_the_viewer_works_from_a_wheel(installed, tmp_path):
    pytest.importorskip("viser", reason="the view extra is not installed")
    (tmp_path / "loop.g2o").write_text("EDGE_SE2 0 1 1 0 1.57 25 0 0 25 0 100\n")
    run(installed / "certpgo", "view", "loop.g2o", "-o", "loop.html", cwd=tmp_path)
    assert "<html" in (tmp_path / "loop.html").read_text()[:1000].lower()
