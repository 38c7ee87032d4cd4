"""Counts in words."""


def counted(count: int, what: str) -> str:
    """The count and what is counted, ``{s}`` marking its plural: 1 node, 2 nodes."""
    return f"{count} {what.replace('{s}', '' if count == 1 else 's')}"
