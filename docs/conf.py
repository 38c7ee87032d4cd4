"""The site: pages of this folder, executed lessons, and a reference generated from the package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

# Lessons print the same digits on every build, for any number of cores.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, (str(ROOT), os.environ.get("PYTHONPATH", "")))
)

# Kernels read no user settings, do not warn that they serve only this machine, and send a cell's
# output in one piece: pieces split by a timer would differ between builds.
KERNEL = """\
from ipykernel.iostream import OutStream
OutStream.flush_interval = 3600.0
c.IPKernelApp.log_level = "ERROR"
"""
profile = ROOT / "build" / "docs-ipython" / "profile_default"
profile.mkdir(parents=True, exist_ok=True)
(profile / "ipython_kernel_config.py").write_text(KERNEL)
os.environ["IPYTHONDIR"] = str(profile.parent)

import matplotlib.font_manager  # noqa: E402, F401 - or the first lesson reports its cache
from extensions import generated  # noqa: E402

import certpgo  # noqa: E402

project = "certpgo"
author = "the certpgo authors"
copyright = "the certpgo authors"
version = release = certpgo.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "extensions.docstrings",
    "extensions.generated",
    "extensions.numbers",
    "extensions.optima",
    "extensions.pictures",
    "extensions.scenes",
]
include_patterns = ["**.md", "**.rst", "lessons/*.py"]  # other Python here is not a page
smartquotes = False  # they would turn -- of --method into a dash
nitpicky = True
# Types of other packages have no page here, and fetching their indices needs a network. Nor have
# type variables; what graphs hold is said with `certpgo.Graph`.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|scipy|matplotlib|collections|dataclasses|fractions|pathlib|types)\..*"),
    (r"py:class", r"concurrent\.futures\..*"),
    (r"py:class", r"certpgo\..*\.Any[A-Z]\w*"),
    (r"py:class", r"certpgo\.checker\.\w+"),
    (r"py:class", r"certpgo\.graph\.graph_data\.GraphData"),
    (r"py:class", r"Point"),  # the alias, within the types of functions
]

# Markdown
myst_enable_extensions = ["amsmath", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3

# Lessons: percent-format Python, executed again when it or the package changes
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "build" / "docs-cache" / generated.package_key())
nb_execution_in_temp = True
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
nb_output_stderr = "warn"
# Solutions are the only hidden cells.
nb_code_prompt_show = "Solution"
nb_code_prompt_hide = "Hide the solution"

# Reference
default_role = "name"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_type_aliases = {
    **{n: f"certpgo.linalg.arrays.{n}" for n in ("FloatArray", "IntArray", "BoolArray", "CSC")},
    "ArrayLike": "numpy.typing.ArrayLike",
    "Label": "certpgo.graph.labels.Label",
}
autodoc_default_options = {"members": True}
python_use_unqualified_type_names = True
python_display_short_literal_types = True

# HTML; maths by the MathJax of a wheel, in one file, so that pages work without a network
html_theme = "furo"
html_title = "certpgo"
html_static_path = ["static"]
html_css_files = ["site.css", "print.css"]
html_js_files = ["optima.js"]
mathjax_path = generated.MATHJAX
mathjax3_config = {"options": {"enableMenu": False}}

linkcheck_timeout = 20
linkcheck_retries = 2
