"""Markdown: sections, printed values, claims and notes."""

from certpgo.harness.formats import Form
from certpgo.harness.render import markdown

FORM = Form("md", "Markdown", markdown)
