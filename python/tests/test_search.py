"""Tests of search methods written in Python."""

import csv
import io

import numpy as np
import pytest

import crumple


class RandomSearch:
    """Search that proposes random points, three at a time."""

    def __init__(self, dimension, seed):
        self.random = np.random.default_rng(seed)
        self.dimension = dimension
        self.received = []

    def ask(self):
        return self.random.random((3, self.dimension))

    def tell(self, robustness):
        self.received += robustness


RANDOM = crumple.SearchMethod(RandomSearch, name="random")


def test_a_campaign_takes_a_search_in_python_and_resumes_it(tmp_path):
    searches = []

    def start(dimension, seed):
        searches.append(RandomSearch(dimension, seed))
        return searches[-1]

    def stop(done, _total, _failures):
        if done > 20:
            raise KeyboardInterrupt

    arguments = {"controller": "match-leader", "budget": 50, "seed": 3}
    whole = crumple.falsify(**arguments, method=crumple.SearchMethod(start, name="random"))
    assert whole.falsified
    assert whole.summary["method"] == "random"
    assert len(searches[0].received) == whole.summary["methods"][0]["evaluations"] == 50
    assert min(searches[0].received) == whole.summary["methods"][0]["best_robustness"] < 0
    with pytest.raises(KeyboardInterrupt):
        crumple.falsify(**arguments, method=RANDOM, folder=tmp_path, progress=stop)
    assert crumple.falsify(**arguments, method=RANDOM, folder=tmp_path, resume=True).summary == whole.summary


def test_methods_are_compared_on_the_same_seeds():
    compared = crumple.compare("match-leader", methods=[RANDOM, "uniform"], seeds=5, budget=100)
    own, uniform = compared.data["methods"]
    assert [len(method["runs"]) for method in compared.data["methods"]] == [5, 5]
    assert own["runs"] != uniform["runs"]
    assert "random against uniform" in str(compared)
    with pytest.raises(crumple.CampaignError, match="given twice"):
        crumple.compare("match-leader", methods=[RANDOM, "uniform", RANDOM], seeds=5, budget=100)


@pytest.mark.parametrize("points", [[[0.5]], [], [[2.0] * 100], None])
def test_wrong_points_are_refused(points):
    class Wrong(RandomSearch):
        def ask(self):
            if points is None:
                raise ZeroDivisionError("in the search")
            return points

    raised = (ZeroDivisionError, "in the search") if points is None else (crumple.CampaignError, "`wrong` must propose")
    if points == [[0.5]]:
        raised = (crumple.CampaignError, r"must propose points of \d+ coordinates, and proposed one of 1$")
    with pytest.raises(raised[0], match=raised[1]):
        crumple.falsify("match-leader", method=crumple.SearchMethod(Wrong, name="wrong"), budget=10)


@pytest.mark.parametrize("wrong", [0, -1, 10**9 + 1, 2.5, "ten", None])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(crumple.CampaignError, match="budget: must be a whole number from 1 to 1000000000") as refused:
        crumple.falsify("idm", budget=wrong)
    assert refused.value.field == "budget"
    with pytest.raises(crumple.CampaignError, match="budget: must be"):
        crumple.compare("idm", methods=["auto"], budget=wrong)
    with pytest.raises(crumple.CampaignError, match="seeds: must be a whole number from 1 to 1000"):
        crumple.compare("idm", methods=["auto"], seeds=wrong)
    with pytest.raises(crumple.RateError, match="runs: must be"):
        crumple.rate("idm", runs=wrong)
    with pytest.raises(crumple.RunError, match="budget: must be"):
        crumple.worst_case("paper-1", budget=wrong if wrong != 10**9 + 1 else 10**7 + 1)


def test_a_comparison_needs_a_method_and_a_seed_that_files_can_hold():
    with pytest.raises(crumple.CampaignError, match="methods: must be from 1"):
        crumple.compare("idm", methods=[], seeds=1, budget=1)
    with pytest.raises(crumple.CampaignError, match="seed: must be"):
        crumple.falsify("idm", budget=1, seed=2**63)


def test_a_comparison_is_exported_as_csv_and_latex():
    comparison = crumple.compare("baseline", methods=["uniform", "halton"], seeds=2, budget=20)
    rows = list(csv.DictReader(io.StringIO(comparison.to_csv())))
    assert [row["method"] for row in rows] == ["uniform", "halton"]
    for row, method in zip(rows, comparison.data["methods"], strict=True):
        assert float(row["falsification_rate"]) == method["falsification_rate"]
        assert [float(row["rate_from"]), float(row["rate_to"])] == method["interval"]
    latex = comparison.to_latex()
    assert latex.startswith(r"\begin{tabular}")
    assert latex.count(r" \\") == 3
    assert r"falsification rate" in latex
    assert "_" not in latex
