"""What the package says about small random graphs, beside an oracle of its own.

See `reports.studies.bookkeeping.__main__`.
"""
