"""What a shell offers for a word that is begun: files, and names that certpgo knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

#: The words that a beginning may become.
Completion = Callable[[str], list[str]]


def graphs(incomplete: str) -> list[str]:
    """Files and folders, and names of datasets that are graphs."""
    return _files_and_datasets(incomplete, "graph")


def inputs(incomplete: str) -> list[str]:
    """Files and folders, and names of all datasets."""
    return _files_and_datasets(incomplete, None)


def _files_and_datasets(incomplete: str, kind: str | None) -> list[str]:
    from certpgo.io.datasets.catalogue import names

    folder, _, beginning = incomplete.rpartition("/")
    here = Path(folder or ("/" if incomplete.startswith("/") else "."))
    found = sorted(p for p in here.glob("*") if p.name.startswith(beginning))
    shown = [f"{folder}/{p.name}" if "/" in incomplete else p.name for p in found]
    files = [name + "/" * path.is_dir() for name, path in zip(shown, found, strict=True)]
    return [*files, *beginning_with(incomplete, names(kind))]


def datasets(incomplete: str) -> list[str]:
    """Names of datasets."""
    from certpgo.io.datasets.catalogue import names

    return beginning_with(incomplete, names())


def methods(incomplete: str) -> list[str]:
    """Names of methods; of several, divided by commas, the last one."""
    from certpgo.registry import solver_names

    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in beginning_with(last, solver_names())]


def formats(incomplete: str) -> list[str]:
    """Names of formats that are written."""
    from certpgo.io.format import formats as known

    written = [name for name, form in known().items() if form.write_graph or form.write_poses]
    return beginning_with(incomplete, written)


def experiments(incomplete: str) -> list[str]:
    """Names of tables and figures."""
    from certpgo.registry import names_in

    named = (names_in(f"reports/{folder}") for folder in ("tables", "figures"))
    return beginning_with(incomplete, [name for listed in named for name in listed])


def one_of(values: Iterable[str]) -> Completion:
    """The words of a list."""
    return lambda incomplete: beginning_with(incomplete, values)


def beginning_with(incomplete: str, names: Iterable[str]) -> list[str]:
    """Names that begin so."""
    return [name for name in names if name.startswith(incomplete)]
