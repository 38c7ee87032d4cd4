"""Search, certify, compare: the certified search and everything that uses it.

Reading order: `solving`, `search`, `search_loop`, then `staircase`, `surrogates` and `range_search`
(its relaxations), `outliers` (finds measurements that disagree) and `robust` (the search without
them); `session` and `merging` for graphs that grow; `assessment`, `comparison` and `bounds_table`
for judging and comparing estimates.
"""
