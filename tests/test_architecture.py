"""The house's rules, read from the code's imports."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from certpgo import checker
from certpgo.graph import edges
from certpgo.linalg import compiled

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "certpgo"
HARNESS = ROOT / "reports" / "harness"
FILES = sorted(PACKAGE.rglob("*.py"))
HARNESS_FILES = sorted(HARNESS.rglob("*.py"))

#: The order of reading: a room imports from rooms of lower rank alone.
RANKS = {
    "_lazy": 0,
    "_start": 0,
    "checker": 0,
    "integer_checker": 0,
    "integer_reader": 0,
    "cycle_checker": 0,
    "errors": 0,
    "linalg": 1,
    "graph": 2,
    "io": 3,
    "objective": 4,
    "optimize": 5,
    "certify": 6,
    "registry": 6,
    "solve": 7,
    "registration": 8,
    "diagnosis": 8,
    "optima": 8,
    "view": 9,
    "plot": 10,
    "__init__": 11,
    "cli": 12,
    "__main__": 13,
}
HARNESS_RANKS = {
    "experiments": 0,
    "rendering": 1,
    "certifiers": 1,
    "scaling": 1,
    "speed": 2,
    "commands": 3,
}

#: Third-party packages with one home each.
HOMES = {
    "cvxpy": ("certpgo/optimize/methods/sdp_",),
    "clarabel": "certpgo/certify/cone_program.py",
    "pymetis": ("certpgo/linalg/factor.py",),
    "pooch": ("certpgo/io/datasets/lookup.py",),
    "rosbags": ("certpgo/io/bags.py",),
    "typer": ("certpgo/cli/", "reports/harness/commands/"),
    "rich": ("certpgo/cli/", "reports/harness/commands/"),
    "threadpoolctl": (
        "certpgo/linalg/threads.py",
        "certpgo/solve/comparison.py",
        "reports/harness/experiments/timing.py",
    ),
    "jinja2": ("certpgo/view/page.py",),
    "flint": ("reports/harness/certifiers/oracle.py",),
    "matplotlib": ("certpgo/view/", "reports/harness/experiments/figure.py"),
    "gtsam": ("certpgo/objective/gtsam_graph.py",),
    "cv2": ("certpgo/registration/",),
    "small_gicp": ("certpgo/registration/dense.py",),
    "skimage": ("certpgo/registration/",),
    "viser": ("certpgo/view/",),
}
#: Lines of a file; each checker is one file, so that it can be copied and read alone.
LONGEST = 400
CHECKERS = {"checker.py": 2241, "integer_checker.py": 1200, "integer_reader.py": 850}
#: Lines of a function, and of a command, without signature and docstring.
LONGEST_FUNCTION, LONGEST_COMMAND = 80, 60


@cache
def tree(path):
    """A file's syntax tree: parsed once."""
    return ast.parse(path.read_text())


@cache
def imports(path):
    """Absolute names of the modules a file imports, and of what it takes from them."""
    names = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def inner(path, root):
    """The parts of a file's path below a root, without suffix."""
    return path.relative_to(root).with_suffix("").parts


def rooms_imported(path, prefix, ranks):
    for name in imports(path):
        rest = name.removeprefix(prefix)
        if rest != name and (room := rest.partition(".")[0]) in ranks:
            yield room


@pytest.mark.parametrize(
    ("root", "prefix", "ranks"),
    [(PACKAGE, "certpgo.", RANKS), (HARNESS, "reports.harness.", HARNESS_RANKS)],
    ids=["certpgo", "harness"],
)
def test_imports_point_down(root, prefix, ranks):
    for path in sorted(root.rglob("*.py")):
        own = inner(path, root)[0]
        if root == HARNESS and own == "__init__":
            continue
        assert own in ranks, f"{own} has no rank: say where it stands"
        for other in rooms_imported(path, prefix, ranks):
            below = ranks[other] < ranks[own] or other == own
            assert below, f"{path.relative_to(ROOT)} imports {other}"


def test_no_files_import_each_other_in_a_circle():
    files = {".".join(inner(path, ROOT)).removesuffix(".__init__"): path for path in FILES}
    files |= {".".join(inner(path, ROOT)).removesuffix(".__init__"): path for path in HARNESS_FILES}
    number = {name: k for k, name in enumerate(files)}
    edges = [
        (number[name], number[other])
        for name, path in files.items()
        for other in imports(path)
        # A package's door is imported with everything behind it.
        if other in files and files[other].name != "__init__.py"
    ]
    i, j = zip(*edges, strict=True)
    graph = coo_array(([1] * len(edges), (i, j)), shape=(len(files), len(files)))
    _, labels = connected_components(graph, directed=True, connection="strong")
    circles = {}
    for name, label in zip(files, labels, strict=True):
        circles.setdefault(label, []).append(name)
    assert [circle for circle in circles.values() if len(circle) > 1] == []


#: What a certificate may know of `optimize`: how work is watched and how it ended.
WATCHED = {"monitor", "progress", "solution", "spectral"}


def test_certificates_know_no_descent():
    rooms = {
        other.removeprefix("certpgo.optimize.").partition(".")[0]
        for path in FILES
        if inner(path, PACKAGE)[0] == "certify"
        for other in imports(path)
        if other.startswith("certpgo.optimize.")
    }
    assert rooms <= WATCHED


#: Questions about the class of a graph or problem in the whole package: at doors alone.
CLASS_QUESTIONS = 25


def test_rooms_ask_a_graph_and_not_its_class():
    asked = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) == "isinstance"
        and any(
            name.endswith(("Graph", "Problem", "Quadratic", "Sum"))
            for name in ast.unparse(node.args[1]).strip("()").replace("|", ",").split(",")
        )
    ]
    assert len(asked) <= CLASS_QUESTIONS, asked


def test_the_library_imports_nothing_of_the_checkout():
    for path in FILES:
        heads = {name.partition(".")[0] for name in imports(path)}
        assert not heads & {"baselines", "reports", "tests"}, path


def test_third_party_packages_have_one_home():
    for path in [*FILES, *HARNESS_FILES]:
        relative = path.relative_to(ROOT).as_posix()
        heads = {name.partition(".")[0] for name in imports(path)}
        for package in heads & HOMES.keys():
            assert relative.startswith(HOMES[package]), f"{relative} imports {package}"


def test_no_assert_and_no_print():
    for path in [*FILES, *HARNESS_FILES]:
        for node in ast.walk(tree(path)):
            place = f"{path}:{getattr(node, 'lineno', 0)}"
            assert not isinstance(node, ast.Assert), place
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id != "print", place


def test_no_file_is_long():
    for path in [*FILES, *HARNESS_FILES]:
        limit = CHECKERS.get(path.name, LONGEST)
        assert len(path.read_text().splitlines()) <= limit, path


def test_no_function_is_long():
    for path in [*FILES, *HARNESS_FILES]:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                lines = node.end_lineno - body[0].lineno + 1 if body else 0
                limit = LONGEST_COMMAND if node.name == "command" else LONGEST_FUNCTION
                assert lines <= limit, f"{path}:{node.lineno} {node.name}"


def test_one_name_is_one_class():
    places = {}
    for path in [*FILES, *HARNESS_FILES]:
        if path.name.endswith(("checker.py", "integer_reader.py")):  # share nothing
            continue
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(path.name)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_the_checker_imports_numpy_and_the_standard_library_alone():
    heads = {name.partition(".")[0] for name in imports(PACKAGE / "checker.py")}
    assert heads - set(sys.stdlib_module_names) == {"numpy"}


def test_the_checker_refuses_the_numbers_that_graphs_refuse():
    assert checker.FAR == edges.FAR


@pytest.mark.parametrize(
    ("name", "quotients"),
    [
        ("integer_checker.py", {"self.lower / self.upper"}),  # of fractions
        ("integer_reader.py", {"path / 'EGs.txt'"}),
    ],
)
def test_the_integer_checker_computes_with_integers_alone(name, quotients):
    path = PACKAGE / name
    heads = {name.partition(".")[0] for name in imports(path)}
    assert heads <= set(sys.stdlib_module_names)
    assert not heads & {"array", "cmath", "ctypes", "random", "statistics", "struct"}
    assert {name for name in imports(path) if name.startswith("math.")} <= {"math.isqrt"}
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Constant):
            assert not isinstance(node.value, float | complex), node.lineno
        if isinstance(node, ast.Name):
            assert node.id not in ("float", "complex", "round", "pow"), node.lineno
    divided = [n for n in ast.walk(tree(path)) if isinstance(getattr(n, "op", None), ast.Div)]
    assert {ast.unparse(n) for n in divided} == quotients


def test_the_cycle_checker_imports_the_standard_library_alone():
    heads = {name.partition(".")[0] for name in imports(PACKAGE / "cycle_checker.py")}
    assert heads <= set(sys.stdlib_module_names)


def third_party_after(statement, parts=1):
    code = (
        f"import sys\n{statement}\n"
        f"heads = {{'.'.join(name.split('.')[:{parts}]) for name in sys.modules}}\n"
        "heads = {h for h in heads if h.partition('.')[0] not in sys.stdlib_module_names}\n"
        "print(*sorted(heads))"
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


def test_solving_loads_numpy_and_scipy_alone():
    theirs = third_party_after("import numpy.testing, scipy.sparse.csgraph, scipy.sparse.linalg")
    assert third_party_after("import certpgo; certpgo.solve") - theirs == {"certpgo"}
    assert {"numpy", "scipy"} <= theirs


def test_the_package_and_its_help_load_no_numerics():
    assert third_party_after("import certpgo") == {"certpgo"}
    for arguments in (["--version"], ["--help"], ["solve", "--help"]):
        loaded = third_party_after(
            "import contextlib, io\nfrom certpgo.cli import main\n"
            f"with contextlib.redirect_stdout(io.StringIO()): main({arguments})"
        )
        assert not {"numpy", "scipy"} & loaded, arguments


def test_functions_win_over_the_subpackages_of_their_names():
    code = (
        "import certpgo.solve.fit, certpgo.solve.judging, certpgo\n"
        "assert callable(certpgo.solve) and callable(certpgo.certify)\n"
        "from certpgo import certify, solve\n"
        "assert certify is certpgo.certify and solve is certpgo.solve"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


#: What takes as long to load as all else that commands need; Pydantic is Typer's.
SLOW = {"scipy.linalg", "scipy.optimize", "scipy.spatial", "scipy.special", "scipy.stats"}
SLOW |= {"scipy.sparse.linalg", "scipy.integrate", "pydantic", "numpy.f2py"}
#: A command, what of that it is spared, and how many modules of ours it loads at most.
STARTS = [
    (("--version",), {*SLOW, "numpy", "scipy"}, 12),
    (("solve", "{g}"), SLOW - {"scipy.special"}, 260),
    (("certify", "{g}", "{e}"), SLOW - {"scipy.special"}, 240),
    (("check", "{g}", "{e}"), {*SLOW, "numpy", "scipy"}, 26),
    (("info", "{g}"), SLOW, 195),
    (("convert", "{g}", "{e}.npz"), SLOW, 135),
]


@pytest.mark.parametrize(
    ("arguments", "spared", "most"), STARTS, ids=[arguments[0] for arguments, _, _ in STARTS]
)
def test_a_command_loads_what_it_needs_alone(arguments, spared, most, tmp_path):
    graph, estimate = tmp_path / "graph.g2o", tmp_path / "estimate.g2o"
    graph.write_text("EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    estimate.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\n")
    line = [argument.format(g=graph, e=estimate) for argument in arguments]
    loaded = third_party_after(
        "sys.argv = ['certpgo']; import contextlib, io, certpgo.cli\n"
        f"with contextlib.redirect_stdout(io.StringIO()): certpgo.cli.main({line!r})",
        parts=4,
    )
    ours = {name for name in loaded if name.startswith("certpgo")}
    assert len(ours) <= most, sorted(ours)
    packages = {".".join(name.split(".")[:parts]) for name in loaded for parts in range(1, 4)}
    if compiled.AVAILABLE:  # SciPy takes the place of the kernel
        assert packages & spared == set()
    heavy = {"gtsam", "cvxpy", "clarabel", "pooch", "matplotlib", "jinja2", "reports"}
    assert packages & heavy == set()


def test_a_command_spares_parts_of_numpy_that_are_there_when_asked_for():
    """SciPy works without its copies of them."""
    code = (
        "import sys\n"
        "sys.argv = ['certpgo']\n"
        "from certpgo import _start\n"
        "import numpy\n"
        "names, listed = numpy.__all__, dir(numpy)\n"
        "_start.import_numerics()\n"
        "assert not {'numpy.f2py', 'numpy.testing', 'numpy.ma'} & {*sys.modules}\n"
        "assert numpy.__all__ is names and sorted(dir(numpy)) == sorted(listed)\n"
        "import scipy.cluster.vq, scipy.ndimage, scipy.optimize, scipy.stats\n"
        "import scipy.sparse.linalg as sla\n"
        "eye = numpy.eye(9)\n"
        "assert abs(sla.eigsh(eye, 1)[0] - 1.0).max() < 1e-9\n"
        "assert abs(scipy.stats.norm.cdf(0.0) - 0.5) < 1e-15\n"
        "assert scipy.optimize.minimize(lambda x: x @ x, numpy.ones(2)).fun < 1e-9\n"
        "assert numpy.f2py and numpy.testing.assert_equal and numpy.ma.array\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_help_loads_no_heavy_package():
    loaded = third_party_after("import certpgo.cli as c; c.application(c.command_names())")
    assert not loaded & {"gtsam", "cvxpy", "pooch", "matplotlib"}
