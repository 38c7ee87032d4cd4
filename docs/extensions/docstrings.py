"""Docstrings as the package writes them: numpydoc's sections, `name : description` in one piece.

Types are described in words with their shape, so everything after the colon is description.
In running text a bar is a norm, an indented paragraph is a formula or a command, and a name in
single backquotes is a link where the reference has such a name, and code elsewhere.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

from docutils import nodes
from docutils.nodes import Element, Node, TextElement, system_message
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PyXRefRole
from sphinx.environment import BuildEnvironment

_UNDERLINE = re.compile(r"-{3,}")
_CODE = re.compile(r"(``.+?``|`[^`]+`)")
_ALIAS = re.compile(r"\w*TypeAliasForwardRef\('([\w.]+)'\)")
_MARK = "certpgo-name"
#: Modules whose objects the reference describes.
_DESCRIBED = ("certpgo", "reports.harness")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect to Sphinx."""
    app.add_role("name", Name())
    app.connect("autodoc-before-process-signature", complete)
    app.connect("autodoc-process-signature", shortened)
    app.connect("autodoc-skip-member", skipped)
    app.connect("autodoc-process-docstring", process)
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Name(PyXRefRole):
    """The default role: a Python name that the reference may or may not describe."""

    def run(self) -> tuple[list[Node], list[system_message]]:
        """One reference, resolved later."""
        self.refdomain, self.reftype, self.classes = "py", "obj", ["xref", "py", "py-obj"]
        found, messages = self.create_xref_node()
        for node in found:
            if isinstance(node, pending_xref):
                node[_MARK] = True
        return found, messages


def resolve(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: TextElement
) -> Element | None:
    """Resolve a public name by its inner address, or a name in backquotes to plain code.

    ``certpgo.io.read`` is described as ``certpgo.read``. A name of the package that is neither in
    the reference nor a module stays unresolved and causes a warning.
    """
    target = str(node.get("reftarget", ""))
    if node.get("refdomain") != "py" or not (node.get(_MARK) or target.startswith("certpgo.")):
        return None
    objects = env.domains["py"].data["objects"]
    full = target.startswith("certpgo.")
    last = f".{target.rpartition('.')[2]}"
    ends = [f"certpgo{last}"] if full else [name for name in objects if name.endswith(f".{target}")]
    found = {objects[name].node_id: objects[name] for name in ends if name in objects}
    if len(found) != 1:
        return content if not full or _is_module(target) else None
    [place] = found.values()
    source = node.get("refdoc", env.current_document.docname)
    link = app.builder.get_relative_uri(source, place.docname) + f"#{place.node_id}"
    return nodes.reference("", "", content, internal=True, refuri=link, reftitle=target)


def _is_module(name: str) -> bool:
    with suppress(ModuleNotFoundError):
        return importlib.util.find_spec(name) is not None
    return False


def complete(app: Sphinx, obj: object, bound: bool) -> None:
    """Add to an object's module the names that its annotations need.

    These are the names imported for type checkers only and, for a class, those that its bases use.
    """
    module = inspect.getmodule(obj)
    if module is None or not module.__name__.startswith(_DESCRIBED):
        return
    _complete(module.__name__)
    owner = getattr(module, getattr(obj, "__qualname__", "").partition(".")[0], None)
    for base in inspect.getmro(owner) if isinstance(owner, type) else ():
        if base.__module__.startswith(_DESCRIBED):
            _complete(base.__module__)
            for name, value in vars(sys.modules[base.__module__]).items():
                if name != "__all__":  # which is about that module's own
                    vars(module).setdefault(name, value)


@cache
def _complete(name: str) -> None:
    module = sys.modules[name]
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            continue
        for line in node.body:
            if isinstance(line, ast.ImportFrom):
                exec(ast.unparse(line), vars(module))


def shortened(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """A signature that can be parsed: a factory default has no text; an alias is its name."""
    parts = (part and _ALIAS.sub(r"\1", part) for part in (signature, returned))
    signature, returned = parts
    return signature and signature.replace("<factory>", "..."), returned


def skipped(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: Any
) -> bool | None:
    """Whether to omit a member: a module's constants are documented in its source only."""
    return True if what == "module" and not callable(obj) else None


def process(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    """Rewrite a docstring in place for autodoc."""
    lines[:] = [line for title, body in _sections(lines) for line in _section(title, body)]


def _sections(lines: list[str]) -> Iterator[tuple[str, list[str]]]:
    title, body = "", []
    for k, line in enumerate(lines):
        after = lines[k + 1] if k + 1 < len(lines) else ""
        if line and _UNDERLINE.fullmatch(after):
            yield title, body
            title, body = line, []
        elif not (title and not body and _UNDERLINE.fullmatch(line)):
            body.append(line)
    yield title, body


def _section(title: str, body: list[str]) -> Iterator[str]:
    if title in {"", "Notes", "Examples"}:
        if title:
            yield from (f".. rubric:: {title}", "")
        yield from _text(body)
        yield ""
        return
    if title == "Returns" and not any(" : " in line for line in body):
        yield f":returns: {_escaped(' '.join(line.strip() for line in body))}".rstrip()
    else:
        mark = "`" if title == "Raises" else "**"
        yield from (f":{title}:", "")
        for names, words in _entries(body):
            shown = ", ".join(f"{mark}{_starless(part)}{mark}" for part in names.split(", "))
            yield f"    * {shown}: {_escaped(' '.join(words))}"
    yield ""


def _starless(name: str) -> str:
    return name.replace("*", "\\*")


def _entries(body: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Names of a section's items, with their descriptions."""
    names, words = "", []
    for line in body:
        if not line.strip():
            continue
        if line[0] != " ":
            if names:
                yield names, words
            names, _, first = line.partition(" : ")
            words = [first] if first else []
        else:
            words.append(line.strip())
    if names:
        yield names, words


def _text(body: list[str]) -> Iterator[str]:
    """Running text: paragraphs, lists, examples, and indented text unchanged."""
    paragraph: list[str] = []
    for line in [*body, ""]:
        if line.strip():
            paragraph.append(line)
            continue
        if paragraph:
            first = paragraph[0]
            if first.startswith(">>>"):
                yield from paragraph
            elif all(part[0] == " " for part in paragraph):
                yield from ("::", "", *(f"  {part}" for part in paragraph))
            else:
                yield from map(_escaped, paragraph)
            yield ""
        paragraph = []


def _escaped(line: str) -> str:
    pieces = _CODE.split(line)
    pieces[::2] = [piece.replace("|", "\\|") for piece in pieces[::2]]
    return "".join(pieces)
