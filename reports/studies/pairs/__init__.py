"""Everything with everything: each pair of what graphs have, costs and operations, tried."""
