import sys
from importlib import import_module

import pytest

from certpgo import registry
from certpgo.errors import InputNotice, SpecError
from certpgo.io.format import formats
from reports.harness.certifiers import rules
from reports.harness.experiments import scan

SOLVER_FILE = """
from dataclasses import dataclass
from typing import ClassVar

from ._shared import VALUE

@dataclass(frozen=True)
class SOLVER:
    value: int = VALUE
    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def solve(self, problem, **more): ...
"""


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    (tmp_path / "baselines").mkdir()
    (tmp_path / "reports" / "tables").mkdir(parents=True)
    (tmp_path / "baselines" / "some_peer.py").write_text(SOLVER_FILE)
    (tmp_path / "baselines" / "_shared.py").write_text("VALUE = 7\n")
    (tmp_path / "reports" / "tables" / "first.py").write_text("TABLE = 'the first table'\n")
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path))
    return tmp_path


def test_baselines_are_found_by_file_name_and_shared_files_are_not(checkout):
    names = registry.solver_names()
    assert "some_peer" in names
    assert not any(name.startswith("_") for name in names)
    assert names == tuple(sorted(names))


def test_a_baseline_is_loaded_by_path_and_may_import_its_neighbour(checkout):
    assert registry.get_solver("some_peer").value == 7


NESTING_SOLVER_FILE = """
from dataclasses import dataclass, field
from typing import ClassVar

@dataclass(frozen=True)
class Inner:
    x: int = 1

@dataclass(frozen=True)
class SOLVER:
    names: tuple[str, ...] = field(default_factory=lambda: ("a", "b"))
    inner: Inner = field(default_factory=Inner)
    other: Inner = Inner()
    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True

    def solve(self, problem, **more): ...
"""


def test_only_nested_settings_cannot_be_set_one_by_one(checkout):
    (checkout / "baselines" / "some_peer.py").write_text(NESTING_SOLVER_FILE)
    solver = registry.get_solver("some_peer")
    assert registry.defaults(solver) == {"names": ("a", "b")}
    assert registry.build("some_peer", {"names": ("c",)}).names == ("c",)
    assert "newton" not in registry.setting_fields(registry.get_solver("certified"))


def test_listing_names_runs_no_file(checkout):
    (checkout / "baselines" / "broken.py").write_text("raise RuntimeError('imported')\n")
    assert "broken" in registry.solver_names()


def test_another_checkout_is_another_set_of_files(checkout, tmp_path, monkeypatch):
    registry.get_solver("some_peer")
    other = tmp_path / "other"
    (other / "baselines").mkdir(parents=True)
    (other / "reports").mkdir()
    (other / "baselines" / "some_peer.py").write_text(SOLVER_FILE)
    (other / "baselines" / "_shared.py").write_text("VALUE = 8\n")
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(other))
    assert registry.get_solver("some_peer").value == 8


def test_an_unknown_method_suggests_the_nearest(checkout):
    with pytest.raises(SpecError, match="unknown method 'some_per'; did you mean some_peer"):
        registry.get_solver("some_per")


def test_a_file_without_solver_is_named(checkout):
    (checkout / "baselines" / "empty.py").write_text("")
    with pytest.raises(SpecError, match=r"empty\.py: must expose SOLVER"):
        registry.get_solver("empty")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 / 0", "broken.py: cannot be loaded: ZeroDivisionError: division by zero"),
        ("def", "broken.py: cannot be loaded: SyntaxError: invalid syntax"),
        ("import no_such_package", "broken.py: cannot be loaded: ModuleNotFoundError"),
        ("raise SystemExit", "broken.py: cannot be loaded: SystemExit"),
        ("SOLVER = 7", "broken.py: SOLVER must be a dataclass"),
        (
            "from dataclasses import dataclass\n@dataclass\nclass SOLVER:\n    poses = True",
            "broken.py: SOLVER lacks rotations, solve",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_named(checkout, text, said):
    (checkout / "baselines" / "broken.py").write_text(text)
    with pytest.raises(SpecError) as caught:
        registry.get_solver("broken")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert registry.get_solver("some_peer").value == 7


def test_a_table_that_cannot_be_loaded_is_named(checkout):
    (checkout / "reports" / "tables" / "second.py").write_text("TABLE = None + 1\n")
    with pytest.raises(SpecError, match=r"second\.py: cannot be loaded: TypeError"):
        scan.get_table("second")


def test_a_format_that_cannot_be_loaded_is_named_and_left_out(tmp_path, monkeypatch):
    package, whole = import_module("certpgo.io.formats"), formats()
    (tmp_path / "broken.py").write_text("1 / 0\n")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    with pytest.warns(InputNotice, match="broken.py: cannot be loaded: ZeroDivisionError"):
        found = formats.__wrapped__()
    assert found.keys() == whole.keys()


def test_tables(checkout):
    assert scan.table_names() == ("first",)
    assert scan.get_table("first") == "the first table"
    with pytest.raises(SpecError, match="unknown table 'frist'; did you mean first"):
        scan.get_table("frist")


def test_without_a_checkout_the_package_still_lists_its_own_methods(tmp_path, monkeypatch):
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path))
    assert scan.table_names() == ()
    assert not any(name.startswith("gtsam_") for name in registry.solver_names())
    for call in (registry.repository, lambda: scan.get_table("first")):
        with pytest.raises(SpecError, match="this needs a checkout of certpgo"):
            call()


def test_the_working_directory_may_be_the_checkout(checkout, tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_PACKAGE", tmp_path / "elsewhere" / "certpgo")
    monkeypatch.delenv(registry.REPOSITORY_VARIABLE)
    monkeypatch.chdir(checkout)
    assert registry.checkout() is None  # a folder of such names may be anybody's
    (checkout / "certpgo").mkdir()
    assert registry.checkout() == checkout.resolve()


def test_this_checkout_lists_the_gtsam_baselines_without_importing_gtsam():
    before = "gtsam" in sys.modules
    listed = [name for name in registry.solver_names() if name.startswith("gtsam_")]
    assert len(listed) == 7
    assert ("gtsam" in sys.modules) == before


def test_competitors_certifiers_are_files_of_a_folder_and_may_import_baselines(checkout):
    folder = checkout / "baselines" / "certifiers"
    folder.mkdir()
    (folder / "some_rule.py").write_text("from .._shared import VALUE\n\nCERTIFIER = VALUE\n")
    assert rules.rule_names() == ("some_rule",)
    assert rules.get_rule("some_rule") == 7
    assert "some_rule" not in registry.solver_names()
    with pytest.raises(SpecError, match="unknown certifier 'some_rul'; did you mean some_rule"):
        rules.get_rule("some_rul")
