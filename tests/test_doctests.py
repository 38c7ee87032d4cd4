"""Every example in a docstring of the package does what it shows."""

import ast
import doctest
import importlib
from pathlib import Path

import pytest

import certpgo

ROOT = Path(certpgo.__file__).parent
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def examples():
    """Names of what has examples, read and not imported: optional packages may be missing."""
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        module = ".".join(("certpgo", *(part for part in parts if part != "__init__")))
        text = path.read_text(encoding="utf-8")
        if ">>> " in text:
            yield from ((module, name) for name in described(ast.parse(text)))


def described(node, prefix=""):
    """Dotted names below a node whose docstrings hold examples."""
    if ">>> " in (ast.get_docstring(node) or ""):
        yield prefix.rstrip(".")
    for child in node.body if isinstance(node, ast.Module | ast.ClassDef) else ():
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            yield from described(child, f"{prefix}{child.name}.")


EXAMPLES = list(examples())


@pytest.mark.parametrize(("module", "name"), EXAMPLES, ids=map(".".join, EXAMPLES))
def test_example(module, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name in ("from_gtsam", "to_gtsam"):
        pytest.importorskip("gtsam")
    owner = importlib.import_module(module)
    found = owner
    for part in filter(None, name.split(".")):
        found = getattr(found, part)
    tests = doctest.DocTestFinder(recurse=False).find(found, name, owner)
    told = []
    for test in tests:
        doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(test, out=told.append)
    assert not told, "".join(told)
    assert sum(len(test.examples) for test in tests)


def test_every_public_name_and_every_method_has_an_example():
    shown = {name for _, name in EXAMPLES}
    # A constant has none.
    assert {name for name in certpgo.__all__ if callable(getattr(certpgo, name))} <= shown
    methods = {path.stem for path in (ROOT / "optimize" / "methods").glob("[a-z]*.py")}
    assert methods
    assert methods <= {module.rpartition(".")[2] for module, _ in EXAMPLES}
