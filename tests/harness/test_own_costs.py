"""A sample of `reports.studies.own_costs`: nothing that is certified in g2o's cost is false."""

from collections import Counter


def test_no_certificate_in_g2os_cost_is_false():
    from reports.studies.own_costs import outcomes

    seeds = range(12)
    found = sum((outcomes(seed, descents=1, brief=seed % 25 > 0) for seed in seeds), Counter())
    assert [outcome for outcome in found if "FALSE" in outcome] == []
    optimal = {k: n for k, n in found.items() if k.startswith("optimal estimates")}
    assert optimal.get("optimal estimates: UNDECIDED", 0) <= 0.1 * sum(optimal.values())


def test_a_bound_above_the_cost_would_be_seen(monkeypatch):
    from dataclasses import replace

    from reports.studies import own_costs

    plain = own_costs.certify

    def boasting(problem, x, **options):
        c = plain(problem, x, **options)
        return replace(c, lower_bound=1.1 * c.cost_upper)

    monkeypatch.setattr(own_costs, "certify", boasting)
    assert any("FALSE" in outcome for outcome in own_costs.outcomes(3, descents=1))
