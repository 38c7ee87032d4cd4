"""The house's rules, read from the code's imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "certpgo"
FILES = sorted(PACKAGE.rglob("*.py"))

#: Lower imports nothing higher; names of one rank never import one another.
RANKS = {
    "checker": 0,
    "errors": 0,
    "monitor": 0,
    "linalg": 1,
    "graph": 2,
    "estimate": 2,
    "cycles": 3,
    "bridges": 3,
    "trees": 3,
    "lift": 3,
    "io": 4,
    "datasets": 4,
    "operators": 4,
    "objective": 5,
    "problem": 5,
    "solution": 6,
    "progress": 6,
    "reduced": 6,
    "averaging": 7,
    "consistency": 8,
    "newton": 7,
    "spectral": 7,
    "starts": 8,
    "roundings": 8,
    "solvers": 8,
    "certify": 8,
    "metrics": 8,
    "staircase": 9,
    "disagreement": 9,
    "solve": 10,
    "registry": 11,
    "robust": 11,
    "harness": 11,
    "cli": 12,
    "__init__": 13,
}
#: Of one rank, and yet: an estimate is checked against nothing of a graph but for its type; the
#: catalogue reads what it finds; a problem is an objective; the harness finds methods by name.
SIBLINGS = {
    ("problem", "objective"),
    ("progress", "solution"),
    ("graph", "estimate"),
    ("datasets", "io"),
    ("harness", "registry"),
}

#: Third-party packages with one home each.
HOMES = {
    "cvxpy": ("solvers/sdp_",),
    "cvxopt": ("linalg/factor.py",),
    "pymetis": ("linalg/factor.py",),
    "pooch": ("datasets/lookup.py",),
    "typer": ("cli/",),
    "rich": ("cli/",),
    "threadpoolctl": ("certify/proof.py",),
    "jinja2": ("view/page.py",),
    "gtsam": (),
}


def part(path):
    """The part of the house a file belongs to: a folder or module below the package."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(path):
    """Absolute names of the modules a file imports, with those under TYPE_CHECKING."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = (PACKAGE.name, *path.relative_to(PACKAGE).parts)
            base = ".".join(parents[: -node.level]) if node.level else ""
            module = ".".join(filter(None, (base, node.module)))
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def house_imports(path):
    for name in imports(path):
        head, _, rest = name.partition(".")
        first = rest.partition(".")[0]
        if head == "certpgo" and first in RANKS:
            yield first


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_down(path):
    own = part(path)
    if own == "checker":
        assert list(house_imports(path)) == []
        return
    assert own in RANKS, f"{own} has no rank: say where it stands"
    for other in house_imports(path):
        below = RANKS[other] < RANKS[own] or other == own or (own, other) in SIBLINGS
        assert below, f"{path.relative_to(ROOT)} imports {other}"


def test_nothing_imports_baselines_or_reports():
    for path in FILES:
        heads = {name.partition(".")[0] for name in imports(path)}
        assert not heads & {"baselines", "reports", "tests"}, path


@pytest.mark.parametrize("package", sorted(HOMES))
def test_third_party_packages_have_one_home(package):
    for path in FILES:
        relative = path.relative_to(PACKAGE).as_posix()
        if package in {name.partition(".")[0] for name in imports(path)}:
            assert relative.startswith(HOMES[package]) if HOMES[package] else False, relative


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_assert_and_no_print(path):
    for node in ast.walk(ast.parse(path.read_text())):
        assert not isinstance(node, ast.Assert), f"{path}:{node.lineno}"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id != "print", f"{path}:{node.lineno}"


def test_no_module_is_above_400_lines():
    long = {str(path): len(path.read_text().splitlines()) for path in FILES}
    long = {path: lines for path, lines in long.items() if lines > 400}
    # One file, so that it can be copied and read alone.
    assert list(long) == [str(PACKAGE / "checker.py")]
    assert long.popitem()[1] <= 900


def test_the_checker_imports_numpy_and_the_standard_library_alone():
    heads = {name.partition(".")[0] for name in imports(PACKAGE / "checker.py")}
    assert heads - set(sys.stdlib_module_names) == {"numpy"}


def third_party_after(statement):
    code = (
        f"import sys\n{statement}\n"
        "heads = {name.partition('.')[0] for name in sys.modules}\n"
        "print(*sorted(h for h in heads if h not in sys.stdlib_module_names))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # What site-packages' own .pth files load at start-up is no import of ours.
    bare = subprocess.run(
        [sys.executable, "-c", code.replace(statement, "")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = set(done.stdout.split()) - set(bare.stdout.split())
    return {name for name in loaded if not name.startswith("_")}


def test_import_certpgo_loads_numpy_and_scipy_alone():
    theirs = third_party_after("import numpy.testing, scipy.sparse.csgraph, scipy.sparse.linalg")
    assert third_party_after("import certpgo") - theirs == {"certpgo"}
    assert {"numpy", "scipy"} <= theirs


def test_the_checker_and_the_command_line_do_not_load_the_heavy_optional_packages():
    loaded = third_party_after("import certpgo.cli; certpgo.cli.application()")
    assert not loaded & {"gtsam", "cvxopt", "cvxpy", "pooch", "matplotlib", "joblib"}
