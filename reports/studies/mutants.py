"""Mutation testing: draws small changes to the code that certifies, which some test must notice.

    python -m reports.studies.mutants --sample 500 --seed 0 [--module certpgo/checker.py ...]

A mutant has a comparison's boundary moved, a sign or an operator swapped, a constant doubled, a
statement left out or the like, in a copy of the checkout, where the module's own tests run on it.
It is killed when one fails or hangs. Mutants that no test can kill are listed, with the reason, in
``reports/studies/mutants.toml``. Exit code 1 when more than 5 % of the others survive.
"""

from __future__ import annotations

import argparse
import ast
import copy
import difflib
import functools
import importlib
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

ROOT = Path(__file__).parents[2]
EQUIVALENT = ROOT / "reports" / "studies" / "mutants.toml"
#: Each module, and the tests that are its own.
TESTS = {
    "certpgo/linalg/factor.py": ("linalg/test_factor*",),
    "certpgo/certify/bounds.py": ("certify/test_bounds*",),
    "certpgo/certify/verdict.py": (
        "certify/test_verdict*",
        "certify/test_parts*",
        "certify/test_extremes*",
        "certify/test_certify*",
        "certify/test_attacks*",
    ),
    "certpgo/certify/certificate.py": ("certify/test_certificate*", "certify/test_certify*"),
    "certpgo/certify/cost_proof.py": ("certify/test_cost_proof*",),
    "certpgo/optimize/curvature.py": ("optimize/test_curvature*",),
    "certpgo/certify/dual.py": ("certify/test_dual*", "certify/test_residual*"),
    "certpgo/solve/judging.py": (
        "certify/test_judge*",
        "certify/test_certify*",
        "certify/test_attacks*",
    ),
    "certpgo/certify/bridge_blocks.py": ("certify/test_parts*",),
    "certpgo/certify/proof.py": ("certify/test_proof*", "test_checker*"),
    "certpgo/certify/proof_file.py": (
        "certify/test_proof*",
        "certify/test_rejection_proof*",
        "test_checker*",
    ),
    "certpgo/certify/residual.py": ("certify/test_residual*",),
    "certpgo/objective/enclosure.py": (
        "certify/test_rounding*",
        "certify/test_dual*",
        "certify/test_extremes*",
    ),
    "certpgo/certify/multipliers.py": ("certify/test_shifted*", "certify/test_dual*"),
    "certpgo/certify/units.py": ("certify/test_extremes*",),
    "certpgo/integer_reader.py": (
        "test_integer_checker*",
        "test_checker_similarities*",
        "test_cycle_checker*",
    ),
    "certpgo/integer_checker.py": (
        "test_integer_checker*",
        "test_checker_g2o*",
        "test_checker_claims*",
        "test_checker_similarities*",
        "certify/test_rejection_proof*",
    ),
    "certpgo/checker.py": (
        "test_checker*",
        "certify/test_proof*",
        "certify/test_cost_proof*",
        "certify/test_rejection_proof*",
    ),
}
#: Share of the mutants that may survive, of those that are not equivalent.
ALLOWED = 0.05
#: Seconds for one test, and for all of them, beyond some times what they take without a mutant.
PATIENCE, FACTOR = 20.0, 5.0
#: Bytes that a mutant may fill.
MEMORY = 6 << 30
#: Exit code of tests that end the process before they are done.
LEFT = 71


# --- The mutants

SWAPPED: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.Pow: (ast.Mult,),
    ast.MatMult: (ast.Mult,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_PAIRS = (
    ("max", "min"),
    ("maximum", "minimum"),
    ("any", "all"),
    ("argmax", "argmin"),
    ("ROUND_CEILING", "ROUND_FLOOR"),
    ("triu_indices", "tril_indices"),
)
RENAMED = dict(_PAIRS) | {b: a for a, b in _PAIRS} | {"rint": "floor", "round": "floor"}
#: Calls that mutants replace by their argument.
DROPPED = {"abs", "sorted"}
_NO_CODE = (ast.JoinedStr, ast.Import, ast.ImportFrom)


@dataclass(frozen=True)
class Mutant:
    """One change: the module, the function it is in, and the lines as `ast.unparse` has them."""

    module: str
    function: str
    before: str
    after: str


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """What a mutant may have instead of a node."""
    match node:
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield from (ast.Constant(value + 1), ast.Constant(value - 1))
        case ast.Constant(value=float() as value):
            yield from map(ast.Constant, (2.0 * value, 0.5 * value) if value else (1.0,))
        case ast.operator() | ast.boolop() | ast.cmpop():
            yield from (other() for other in SWAPPED.get(type(node), ()))
        case ast.UnaryOp():
            yield node.operand
        case ast.Name(id=name) if name in RENAMED:
            yield ast.Name(RENAMED[name], node.ctx)
        case ast.Attribute(attr=name) if name in RENAMED:
            yield ast.Attribute(node.value, RENAMED[name], node.ctx)
        case ast.Attribute(attr="inf"):
            yield ast.UnaryOp(ast.USub(), node)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            if name in DROPPED and node.args:
                yield node.args[0]
            for k in range(len(node.keywords)):
                kept = node.keywords[:k] + node.keywords[k + 1 :]
                yield ast.Call(node.func, node.args, kept)
        case ast.Break():
            yield ast.Continue()
        case ast.Continue():
            yield ast.Break()
        case ast.Raise() | ast.AugAssign() | ast.Delete() | ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield ast.Pass()
    if isinstance(node, (ast.If, ast.While, ast.IfExp)) and not isinstance(node.test, ast.Compare):
        turned = copy.copy(node)
        turned.test = ast.UnaryOp(ast.Not(), node.test)
        yield turned
    if isinstance(node, ast.AugAssign):
        for other in SWAPPED.get(type(node.op), ()):
            yield ast.AugAssign(node.target, other(), node.value)


def places(node: ast.AST, function: str = "") -> Iterator[tuple[str, ast.AST, str, int | None]]:
    """(function, parent, field, index) of all code below a node: no words, no types."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type", "exc", "cause"):
            continue
        if field == "op" and isinstance(node, ast.AugAssign | ast.UnaryOp):
            continue  # theirs are variants of the whole
        for k, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if not isinstance(child, ast.AST) or isinstance(child, _NO_CODE):
                continue
            if isinstance(child, ast.ClassDef) and "Protocol" in map(ast.unparse, child.bases):
                continue
            if field == "slice" and getattr(node.value, "attr", "") == "shape":
                continue  # another side of a square matrix, mostly
            inner = function
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                inner = f"{function}.{child.name}".lstrip(".")
            yield function, node, field, k
            yield from places(child, inner)


def mutants(module: str) -> dict[Mutant, str]:
    """All mutants of a module, and its text with each."""
    tree = ast.parse((ROOT / module).read_text())
    parts = [ast.unparse(statement) for statement in tree.body]
    found: dict[Mutant, str] = {}
    for at, part in enumerate(parts):
        statement = ast.Module([tree.body[at]], [])
        for function, parent, field, k in list(places(statement)):
            siblings = getattr(parent, field)
            node = siblings if k is None else siblings[k]
            for other in variants(node):
                _put(parent, field, k, other)
                text = ast.unparse(statement)
                mutant = Mutant(module, function, *_difference(part, text))
                while mutant in found:  # one more like it, in the same function
                    mutant = Mutant(module, f"{mutant.function}'", mutant.before, mutant.after)
                found[mutant] = "\n".join([*parts[:at], text, *parts[at + 1 :]]) + "\n"
            _put(parent, field, k, node)
    return found


def _difference(before: str, after: str) -> tuple[str, str]:
    """The lines in which two texts differ, of each."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    change = list(lines)[2:]
    before, after = ("\n".join(s[1:].strip() for s in change if s[0] == side) for side in "-+")
    return before, after


def _put(parent: ast.AST, field: str, k: int | None, node: ast.AST) -> None:
    if k is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[k] = node


def modules() -> list[str]:
    """Paths of the modules that certify."""
    folder = (ROOT / "certpgo" / "certify").glob("[!_]*.py")
    return sorted({*TESTS, *(path.relative_to(ROOT).as_posix() for path in folder)})


def tests_of(module: str, root: Path) -> list[str]:
    """The files of a module's own tests: of one that `TESTS` lacks, all of the certificates'."""
    patterns = TESTS.get(module, ("certify/test_*",))
    found = {path for pattern in patterns for path in root.glob(f"tests/{pattern}.py")}
    return sorted(path.relative_to(root).as_posix() for path in found)


def equivalent() -> dict[Mutant, str]:
    """Those that no test can kill, and why; ``*`` stands for all mutants of a line."""
    entries = tomllib.loads(EQUIVALENT.read_text()).get("mutant", [])
    return {
        Mutant(entry["module"], entry["function"], entry["before"], after): entry["reason"]
        for entry in entries
        for after in entry["after"]
    }


def excused(mutant: Mutant, known: Collection[Mutant]) -> Mutant | None:
    """The entry of `equivalent` that a mutant falls under, if any."""
    return next((m for m in (mutant, replace(mutant, after="*")) if m in known), None)


# --- Running them


class Session:
    """The plugin of a run: quick tests first, no shrinking, a limit on each test's time."""

    def __init__(self, times: Path) -> None:
        self.file = times
        self.times: dict[str, float] = json.loads(times.read_text()) if times.exists() else {}
        self.measured: dict[str, float] = {}

    def pytest_configure(self) -> None:
        """Hypothesis as the tests have it, but done at the first failure."""
        from hypothesis import Phase, settings

        phases = (Phase.explicit, Phase.generate)
        settings.register_profile(
            "mutants", derandomize=True, deadline=None, phases=phases, report_multiple_bugs=False
        )
        settings.load_profile("mutants")

    def pytest_collection_modifyitems(self, items: list) -> None:
        """Quick tests first."""
        items.sort(key=lambda item: self.times.get(item.nodeid, 0.0))

    def pytest_runtest_setup(self, item: object) -> None:
        """Starts the test's clock."""
        seconds = PATIENCE + FACTOR * self.times.get(item.nodeid, 60.0)
        signal.signal(signal.SIGALRM, _too_long)
        signal.setitimer(signal.ITIMER_REAL, seconds)

    def pytest_runtest_teardown(self) -> None:
        """Stops it."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def pytest_collectreport(self, report: object) -> None:
        """Names the file that cannot even be imported."""
        self.pytest_runtest_logreport(report)

    def pytest_runtest_logreport(self, report: object) -> None:
        """Names the test that fails."""
        if report.when != "collect":  # a test; its fixtures take time as well
            self.measured[report.nodeid] = self.measured.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            print(f"\nFAILED-IN {report.nodeid} {'TIMEOUT' if _fired else ''}")

    def pytest_sessionfinish(self) -> None:
        """Keeps the times of a run that had none."""
        if not self.times:
            self.file.write_text(json.dumps(self.measured))


class Hangs(BaseException):
    """A test takes too long; nobody catches that."""


_fired: list[int] = []


def _too_long(*_: object) -> None:
    _fired.append(1)
    raise Hangs


def preload() -> None:
    """Imports what every run does, but for the package: runs are forks of this process."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name in ("flint", "hypothesis", "pytest", "scipy.sparse.linalg", "scipy.spatial.transform"):
        importlib.import_module(name)


def run_tests(folder: Path, files: list[str], session: Session) -> int:
    """In a process of its own: the tests, until one fails. Pytest's exit code."""
    import pytest

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.chdir(folder)
    sys.path[0] = str(folder)
    os.environ.update(PYTHONPATH=str(folder), CERTPGO_REPOSITORY=str(folder))
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    # No assertions are rewritten: that would take longer than many a test.
    arguments = ["-x", "-q", "--tb=line", "--assert=plain", "-p", "no:cacheprovider", *files]
    try:
        code = int(pytest.main(arguments, plugins=[session]))
    except SystemExit:  # while a conftest is imported
        return LEFT
    return LEFT if code == pytest.ExitCode.INTERNAL_ERROR else code  # and later


def forked(task: Callable[[], int], limit: float) -> tuple[int | None, str]:
    """The exit code of a task in a fork, None after ``limit`` seconds, and its words."""
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if not child:
            code = 70
            try:
                os.setsid()
                os.dup2(said.fileno(), 1)
                os.dup2(said.fileno(), 2)
                code = task()
            finally:
                sys.stdout.flush()
                os._exit(code)
        end, code = time.perf_counter() + limit, None
        while code is None and time.perf_counter() < end:
            time.sleep(0.01)
            done, status = os.waitpid(child, os.WNOHANG)
            code = os.waitstatus_to_exitcode(status) if done else None
        if code is None:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
        said.seek(0)
        return code, said.read().decode(errors="replace")


class Copy:
    """A copy of the checkout, in which mutants take their module's place one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        hidden = shutil.ignore_patterns(".git", ".venv", "build", "__pycache__", "results", ".*")
        shutil.copytree(ROOT, folder, ignore=hidden, symlinks=True)
        # By their hash: a mutant of the same size and second must not pass for the original.
        mode = ["--invalidation-mode", "checked-hash"]
        command = [sys.executable, "-m", "compileall", "-q", *mode, "certpgo"]
        subprocess.run(command, cwd=folder, check=True)

    def _run(self, module: str, limit: float) -> tuple[str, str]:
        """What became of it, and the test that said so."""
        session = Session(self.folder / f"{module.replace('/', '.')}.times")
        files = tests_of(module, self.folder)
        code, said = forked(lambda: run_tests(self.folder, files, session), limit)
        if code is None:
            return "timeout", ""
        if code == 0:
            return "survived", ""
        words = next((x.split() for x in said.splitlines() if x.startswith("FAILED-IN")), None)
        if words:
            return "timeout" if "TIMEOUT" in words else "killed", words[1]
        if code < 0 or code == LEFT or "ImportError while loading conftest" in said:
            return "killed", f"exit code {code}"
        raise SystemExit(f"{module}: no test failed, and yet {code}:\n{said[-2000:]}")

    @functools.cache  # noqa: B019
    def limit(self, module: str) -> float:
        """Seconds for a module's tests, which pass as it is."""
        start = time.perf_counter()
        fate, words = self._run(module, math.inf)
        if fate != "survived":
            raise SystemExit(f"{module}: its tests fail without a mutant: {words}")
        return PATIENCE + FACTOR * (time.perf_counter() - start)

    def fate(self, mutant: Mutant, text: str) -> tuple[str, str]:
        """``killed``, ``timeout`` or ``survived``, and by which test."""
        limit, path = self.limit(mutant.module), self.folder / mutant.module
        original = path.read_text()
        path.write_text(text)
        try:
            return self._run(mutant.module, limit)
        finally:
            path.write_text(original)


def campaign(chosen: dict[Mutant, str], out: Path) -> dict[Mutant, str]:
    """What becomes of each; written to ``out``, from which an interrupted one goes on."""
    known, fates = equivalent(), {}
    if out.exists():
        for record in map(json.loads, out.read_text().splitlines()):
            mutant = Mutant(**{k: record[k] for k in Mutant.__dataclass_fields__})
            if record["fate"] != "survived":
                fates[mutant] = record["fate"]
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, out.open("a") as stream:
        tree = Copy(Path(folder) / "tree")
        for number, (mutant, text) in enumerate(chosen.items(), 1):
            if mutant in fates:
                continue
            if excused(mutant, known):
                fate, by = "equivalent", ""
            else:
                fate, by = tree.fate(mutant, text)
            fates[mutant] = fate
            stream.write(json.dumps({**asdict(mutant), "fate": fate, "by": by}) + "\n")
            stream.flush()
            if fate in ("survived", "timeout"):
                print(f"{number}/{len(chosen)} {fate}: {mutant.module}, {mutant.function}")
                print(f"  - {mutant.before}\n  + {mutant.after}", flush=True)
    return {mutant: fates[mutant] for mutant in chosen}


def report(fates: dict[Mutant, str]) -> float:
    """A line for each module; the share of those that survived and are not equivalent."""
    for module in [*sorted({mutant.module for mutant in fates}), ""]:
        of = [fate for mutant, fate in fates.items() if module in (mutant.module, "")]
        counts = {k: of.count(k) for k in ("killed", "timeout", "equivalent", "survived")}
        share = counts["survived"] / max(1, len(of) - counts["equivalent"])
        words = ", ".join(f"{count} {name}" for name, count in counts.items())
        print(f"{module or 'all':<32} {len(of):5d}: {words}, {share:.1%} survive")
    return share


def main() -> int:
    """The campaign that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--sample", type=int, default=500, help="how many mutants, drawn from all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--module", action="append", choices=modules(), help="these alone")
    parser.add_argument("--function", action="append", help="of these prefixes alone")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.jsonl")
    parser.add_argument("--count", action="store_true", help="say how many there are, run none")
    asked = parser.parse_args()
    every = [item for name in asked.module or modules() for item in mutants(name).items()]
    prefixes = tuple(asked.function or [""])
    every = [item for item in every if item[0].function.startswith(prefixes)]
    if asked.count:
        for name in asked.module or modules():
            print(f"{name:<32} {sum(mutant.module == name for mutant, _ in every):5d}")
        return 0
    chosen = random.Random(asked.seed).sample(every, min(asked.sample, len(every)))
    preload()
    # Module by module, so that their tests are timed once.
    return int(
        report(campaign(dict(sorted(chosen, key=lambda m: m[0].module)), asked.out)) > ALLOWED
    )


if __name__ == "__main__":
    sys.exit(main())
