"""Benchmarks of certpgo: experiments, their rendering, and studies of certifiers and scaling.

Not part of the wheel. Reading order: `experiments` (what is run, and its records), `rendering`
(tables, pages and the report made of records), `certifiers` and `scaling` (studies with records of
their own), `commands` (what ``certpgo`` gains in a checkout).
"""
