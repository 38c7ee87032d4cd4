"""What a cluster gains: measured with two processes, simulated for more.

    python -m reports.studies.distributed [TURNS]

Solves a helix of TURNS^2 poses on this process, on two threads and on two worker processes, and
prints seconds and bounds. Then runs the tasks of one certificate's factorization one after another
and simulates them, with these times, on 2 to 64 workers that exchange 1 GB/s: a simulation, of
workers that nobody has seen.
"""

import argparse
import heapq
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import certpgo
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import factor
from certpgo.linalg.distributed.fronts import DistributedFronts
from certpgo.linalg.distributed.tasks import Key, TaskGraph
from certpgo.linalg.multifrontal import Fronts, Tree
from certpgo.objective.problem import PoseProblem

#: Bytes per second between two workers, and seconds from request to response.
BANDWIDTH, LATENCY = 1e9, 1e-3


@dataclass
class Measured:
    """Runs tasks one after another, and measures."""

    seconds: dict[Key, float]
    size: dict[Key, int]
    needs: dict[Key, list[Key]]

    def compute(self, graph: TaskGraph, keys: Sequence[Key]) -> list[Any]:
        """The results of these calls; what nobody needs any more is dropped."""
        self.needs |= {key: _keys_in(call, graph) for key, call in graph.calls.items()}
        pending = Counter(need for key in graph.calls for need in self.needs[key])
        pending.update(keys)
        results: dict[Key, Any] = {}
        for key, (function, *arguments) in graph.calls.items():
            begin = time.perf_counter()
            results[key] = function(*(_filled(x, results) for x in arguments))
            self.seconds[key] = time.perf_counter() - begin
            self.size[key] = _bytes_of(results[key])
            pending.subtract(self.needs[key])
            for need in self.needs[key]:
                if not pending[need]:
                    results.pop(need, None)
        return [results[key] for key in keys]

    keep = compute

    def simulated(self, workers: int) -> float:
        """Seconds on that many workers: longest remaining path first, where it ends earliest."""
        rest: dict[Key, float] = {}
        users: dict[Key, list[Key]] = {key: [] for key in self.needs}
        for key, needs in self.needs.items():
            for need in needs:
                users[need].append(key)
        for key in reversed(self.needs):
            rest[key] = self.seconds[key] + max((rest[user] for user in users[key]), default=0.0)
        missing = {key: len(set(needs)) for key, needs in self.needs.items()}
        ready = [(-rest[key], key) for key, count in missing.items() if not count]
        heapq.heapify(ready)
        free, home, end = [0.0] * workers, {}, {}
        while ready:
            key = heapq.heappop(ready)[1]
            best = min((self._end(key, w, free, home, end), w) for w in range(workers))
            end[key], home[key] = best
            free[best[1]] = best[0]
            for user in set(users[key]):
                missing[user] -= 1
                if not missing[user]:
                    heapq.heappush(ready, (-rest[user], user))
        return max(end.values())

    def _end(
        self,
        key: Key,
        worker: int,
        free: list[float],
        home: dict[Key, int],
        end: dict[Key, float],
    ) -> float:
        begin = free[worker]
        for need in self.needs[key]:
            moved = home[need] != worker
            begin = max(begin, end[need] + moved * (LATENCY + self.size[need] / BANDWIDTH))
        return begin + self.seconds[key]


def _keys_in(call: Any, graph: TaskGraph) -> list[Key]:
    if isinstance(call, str) and call in graph.calls:
        return [call]
    if isinstance(call, list | tuple):
        return [key for part in call for key in _keys_in(part, graph)]
    return []


def _filled(argument: Any, results: dict[Key, Any]) -> Any:
    if isinstance(argument, str):
        return results.get(argument, argument)
    if isinstance(argument, list):
        return [_filled(part, results) for part in argument]
    return argument


def _bytes_of(result: Any) -> int:
    parts = vars(result).values() if hasattr(result, "__dict__") else [result]
    return sum(part.nbytes for part in parts if isinstance(part, np.ndarray))


def solved(turns: int) -> None:
    """The whole solution, on one process, on threads and on a cluster."""
    from distributed import LocalCluster

    graph = helix(turns, np.random.default_rng(0)).graph
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(host="127.0.0.1", **local) as cluster:
        for name, where in (
            ("this process", None),
            ("two threads", "threads"),
            ("two processes", cluster.scheduler_address),
        ):
            begin = time.perf_counter()
            if where is None:
                answer = certpgo.solve(graph)
            else:
                with certpgo.scheduler(where):
                    answer = certpgo.solve(graph)
            seconds, bound = time.perf_counter() - begin, answer.certificate.lower_bound
            print(f"{name:14} {seconds:7.1f} s  {answer.verdict.value}  F* >= {bound!r}")


def certificate(turns: int) -> None:
    """The factorization of a certificate: measured in one piece and by tasks, and simulated."""
    instance = helix(turns, np.random.default_rng(0))
    problem = PoseProblem(instance.graph)
    A = problem.data_matrix
    data = np.ascontiguousarray(A.data)
    data[problem.pattern.layout(4).diagonal[:, range(4), range(4)]] *= 1.0 + 1e-6
    tree = Tree.of(problem.pattern.indptr, problem.pattern.indices, problem.order)
    sizes = np.full(problem.n, 4)
    whole, measured = Fronts(tree, sizes), Measured({}, {}, {})
    parts = DistributedFronts(tree, sizes, measured)
    weights = np.ones((2, whole.size))
    begin = time.perf_counter()
    expected = whole.eliminate(data, weights=weights)
    one = time.perf_counter() - begin
    _ = parts.kept_fronts
    found = parts.eliminate(data, weights=weights)
    if expected is None or found is None:
        raise SystemExit("the matrix is not positive definite")
    off = float(np.abs(found.sums / expected.sums - 1.0).max())
    tasks = sum(measured.seconds.values())
    print(f"certificate of {problem.n} poses: {one:.2f} s in one piece; row sums off by {off:.0e}")
    print(f"{len(measured.seconds)} tasks, together {tasks:.2f} s; simulated:")
    for workers in (1, 2, 4, 8, 16, 32, 64):
        seconds = measured.simulated(workers)
        print(f"  {workers:2} workers {seconds:7.2f} s, {one / seconds:5.1f} times as fast")


def main() -> None:
    """Both, for graphs of the size that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("turns", type=int, nargs="?", default=316)
    parser.add_argument("--only-certificate", action="store_true")
    options = parser.parse_args()
    factor.DISTRIBUTED_FROM = 1e9
    if not options.only_certificate:
        solved(options.turns)
    certificate(options.turns)


if __name__ == "__main__":
    main()
