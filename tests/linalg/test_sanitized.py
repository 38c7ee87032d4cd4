"""The kernel's tests again, compiled with sanitizers of addresses and undefined behaviour."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from certpgo.linalg import compiled

ROOT = Path(__file__).parents[2]
#: Tests of all calls of the kernel, with arguments that belong together and that do not.
CHOSEN = (
    "linalg/test_multifrontal.py",
    "linalg/test_balls.py",
    "linalg/test_blocks.py",
    "linalg/test_selected_inverse.py",
    "linalg/test_so.py",
    "graph/test_trees.py",
    "objective/test_edge_sums.py",
    "objective/test_plain_edges.py",
    "io/test_fields.py",
    "objective/test_own_cost.py::test_compiled_equations_are_those_in_numpy",
)
#: Without tests of processes and threads.
BRIEF = "not environment and not threads and not reads_what_python_reads"
#: Python gives back no memory at its end, and a request of too much is an error there.
LENIENT = "detect_leaks=0:allocator_may_return_null=1"
#: Loads the kernel from the first argument, and runs pytest with the others.
PROGRAM = """
import sys
from importlib.util import module_from_spec, spec_from_file_location

import certpgo.linalg

spec = spec_from_file_location("certpgo.linalg._kernel", sys.argv[1])
kernel = module_from_spec(spec)
sys.modules[spec.name] = certpgo.linalg._kernel = kernel
spec.loader.exec_module(kernel)

import pytest

sys.exit(pytest.main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    """The kernel with sanitizers, and the runtime that must be loaded first."""
    compiler = shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs gcc on Linux")
    runtime = Path(
        subprocess.run(
            [compiler, "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
    )
    if not runtime.is_absolute():
        pytest.skip("gcc's sanitizers are not installed")
    kernel = tmp_path_factory.mktemp("sanitized") / "_kernel.so"
    options = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O0", "-g1"]
    options += ["-shared", "-fPIC", "-I", sysconfig.get_path("include"), "-o", str(kernel)]
    source = ROOT / "certpgo" / "linalg" / "kernel" / "module.c"
    subprocess.run([compiler, *options, source, "-lm"], check=True)
    return kernel, runtime


@pytest.mark.slow
@pytest.mark.skipif(not compiled.AVAILABLE, reason="without a C compiler")
def test_the_kernel_stays_within_its_arrays(sanitized, tmp_path):
    kernel, runtime = sanitized
    own = os.environ | {"LD_PRELOAD": str(runtime), "ASAN_OPTIONS": LENIENT}
    own |= {"UBSAN_OPTIONS": "print_stacktrace=1", "PYTHONMALLOC": "malloc"}
    # With another capture the sanitizers' last words would be lost.
    options = ["--capture=sys", "--basetemp", str(tmp_path / "own"), "-k", BRIEF]
    options += ["-p", "no:cacheprovider", "-p", "no:xdist"]
    tests = [str(ROOT / "tests" / name) for name in CHOSEN]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(kernel), *options, *tests],
        cwd=ROOT,
        env=own,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    assert " passed" in done.stdout.splitlines()[-1]
