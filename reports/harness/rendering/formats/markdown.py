"""Markdown: sections, printed values, claims and notes."""

from reports.harness.rendering.formats import Form
from reports.harness.rendering.render import table_markdown

FORM = Form("md", "Markdown", table_markdown)
