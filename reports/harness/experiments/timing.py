"""The timing protocol, one for everything.

One core, every thread pool at one; graphs in memory and prepared; a warm-up, then A B A B ..., and
the median of the per-round ratios of processor time, which a machine's other work moves least.
"""

from __future__ import annotations

import gc
import importlib.util
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from statistics import median

from certpgo.errors import InputError

Step = Callable[[], object]

#: Variables that thread pools read when they start.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Ratio:
    """How two steps compare.

    Attributes
    ----------
    first, second : median seconds of the processor
    ratio : median over the rounds of first / second
    rounds : the ratio of each round
    """

    first: float
    second: float
    ratio: float
    rounds: tuple[float, ...]


def paired(first: Step, second: Step, *, rounds: int = 7) -> Ratio:
    """Time two steps in turn, after one warm-up of each.

    Raises
    ------
    InputError
        ``rounds`` is less than 1.
    """
    if rounds < 1:
        raise InputError(f"rounds must be at least 1, not {rounds}")
    first(), second()
    pairs = [(_seconds(first), _seconds(second)) for _ in range(rounds)]
    ratios = tuple(a / b for a, b in pairs)
    return Ratio(median(a for a, _ in pairs), median(b for _, b in pairs), median(ratios), ratios)


@contextmanager
def one_core() -> Iterator[str]:
    """Pin the process to one core and thread pools to one thread; yields what was achieved."""
    with ExitStack() as stack:
        said = [_pinned(stack), single_threaded(stack)]
        yield ", ".join(said)


def _pinned(stack: ExitStack) -> str:
    if not hasattr(os, "sched_setaffinity"):
        return "not pinned (this system cannot)"
    before = os.sched_getaffinity(0)
    stack.callback(os.sched_setaffinity, 0, before)
    core = max(before)
    os.sched_setaffinity(0, {core})
    return f"pinned to core {core}"


def single_threaded(stack: ExitStack) -> str:
    """Limit thread pools to one thread until the stack unwinds; returns what was achieved."""
    if importlib.util.find_spec("threadpoolctl") is not None:
        from threadpoolctl import threadpool_limits

        stack.enter_context(threadpool_limits(limits=1))
        return "one thread"
    if all(os.environ.get(name) == "1" for name in THREAD_VARIABLES):
        return "one thread (environment)"
    return f"threads not limited (install threadpoolctl, or set {THREAD_VARIABLES[0]}=1)"


def processor_seconds() -> float:
    """Processor time of this process and of the processes it has waited for.

    Where the system does not count those of others: the time that has passed.
    """
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _seconds(step: Step) -> float:
    gc.collect()
    start = processor_seconds()
    step()
    return processor_seconds() - start
