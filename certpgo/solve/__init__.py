"""Search, certify, compare: the certified search and everything that uses it.

Reading order: `solving`, `search` (a plan for each kind of cost, points of its relaxations),
`search_loop` and `endings`; `outliers` (finds measurements that disagree) and `robust` (the search
without them); `session` and `merging` for graphs that grow; `assessment`, `comparison` and
`bounds_table` for judging and comparing estimates.
"""
