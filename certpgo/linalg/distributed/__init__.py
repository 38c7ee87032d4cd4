"""Factorizations as tasks of the elimination tree, on the threads of a machine or on a cluster.

`branches` cuts the tree into subtrees and separators, `tiles` has what a task computes, `fronts`
makes graphs of tasks, and `schedulers` runs them. Row sums that bound rounding are added up over
tasks, so that the bound is that of one machine.
"""
