import os
import subprocess
import sys
import time

import pytest

from certpgo.errors import InputError
from reports.harness.experiments.timing import (
    THREAD_VARIABLES,
    one_core,
    paired,
    processor_seconds,
)


def test_steps_alternate_after_one_warm_up_each():
    calls = []
    result = paired(lambda: calls.append("a"), lambda: calls.append("b"), rounds=3)
    assert "".join(calls) == "ab" * 4
    assert len(result.rounds) == 3
    assert result.ratio == sorted(result.rounds)[1]


def test_processor_time_counts_processes_and_no_waiting():
    pytest.importorskip("resource", reason="this system does not count other processes")
    begin = processor_seconds()
    time.sleep(0.3)
    assert processor_seconds() - begin < 0.2
    program = "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", program], check=True)
    assert processor_seconds() - begin > 0.29


def test_no_round_is_no_measurement():
    with pytest.raises(InputError, match="at least 1"):
        paired(int, int, rounds=0)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system cannot pin")
def test_the_process_is_pinned_and_set_free_again():
    before = os.sched_getaffinity(0)
    with one_core() as kept:
        assert len(os.sched_getaffinity(0)) == 1
        assert "pinned" in kept
    assert os.sched_getaffinity(0) == before


def test_without_threadpoolctl_the_environment_decides(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for value, said in (("1", "one thread (environment)"), ("4", "threads not limited")):
        for name in THREAD_VARIABLES:
            monkeypatch.setenv(name, value)
        with one_core() as kept:
            assert said in kept
