"""What the lesson *What rejecting proves* says."""

import pytest


@pytest.fixture
def shown(lesson):
    return lesson("what_rejecting_proves")


def test_parabolas_are_below_the_truncated_cost_and_touch_it(shown):
    assert all(-1e-12 < gap < 1e-3 for gap in shown["gaps"].values())
    assert shown["weight"](6.0) == pytest.approx(0.125)


def test_all_wrong_loops_are_rejected_and_no_choice_is_better(shown):
    answer, ranked = shown["answer"], shown["ranked"]
    m, count = shown["graph"].num_edges, shown["wrong_count"]
    assert answer.solution.rejected.tolist() == list(range(m - count, m))
    assert answer.rejection.verdict.value == "CERTIFIED"
    assert ranked[0] == pytest.approx(answer.rejection.certificate.cost_upper)
    assert ranked[1] > ranked[0] + 100.0
    assert len(shown["report"].cores) == count
    assert all(edge.is_refuted for edge in shown["report"].edges)


def test_a_loop_that_bends_a_chain_is_ambiguous(shown):
    assert shown["doubtful"].limited_by.value == "ambiguous"
    assert shown["together"].cost < 0.1 * shown["doubtful"].cost_upper


def test_a_wrong_majority_is_certified(shown):
    assert shown["verdict"].verdict.value == "CERTIFIED"
