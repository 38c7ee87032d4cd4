"""Whether descents from random starts beat answers that are BOUNDED.

    python -m reports.studies.restarts

200 random graphs, 50 restarts each. Prints every answer that is beaten, and how many are.
"""

from certpgo.certify import Verdict
from reports.harness.scaling import restarts


def main() -> None:
    """Print what is beaten, and by how much of F."""
    graphs = enumerate(restarts.graphs(200, seed=1))
    outcomes = [restarts.attacked(k, graph, 50) for k, graph in graphs]
    bounded = [outcome for outcome in outcomes if outcome.verdict is Verdict.BOUNDED]
    for outcome in bounded:
        if outcome.excess > 1e-6:
            print(f"graph {outcome.number}: beaten by {outcome.excess:.1e} of F")
    beaten = sum(outcome.excess > 1e-6 for outcome in bounded)
    print(f"200 graphs, {len(bounded)} BOUNDED, {beaten} of these beaten by 50 restarts")


if __name__ == "__main__":
    main()
