"""The league's page judges every aim by the whole interval, and pairs the errors of equal starts."""

import json

import numpy as np
import pytest

from bojax.report.league.aims import MISSED, OPEN, REACHED, UNTESTED, judged
from bojax.report.league.page import write_pages
from bojax.report.league.results import CELLS, LEAGUE, League
from bojax.results.store import ResultsError

FIELDS = {"one": {"place": "square", "is_real": True}, "coast": {"place": "coast", "is_real": True}}


def write_league(folder, errors, seconds=1.0, starts=5):
    """A league in which each method's errors are those of a function of field, method and start."""
    (folder / CELLS).mkdir(parents=True)
    about = {"fields": FIELDS, "lengths": [40], "process": {"variance": 1.0}, "sampling": 0.2, "noise": 0.1}
    about |= {"leg": 5.0, "share_above": 0.2, "peers": "stored", "provenance": {"command": "bojax"}}
    (folder / LEAGUE).write_text(json.dumps(about))
    for start in range(starts):
        for goal, methods in (
            ("map", ("bojax", "lawnmower", "SGP-Tools", "myopic", "random")),
            ("hotspots", ("bojax, hotspots",)),
            ("threshold", ("bojax, threshold",)),
        ):
            for field in FIELDS:
                known = [each for each in methods if field == "one" or each != "SGP-Tools"]
                measures = ("rmse", "rmse_learned", "deviation", "regret", "missed", "f1")
                cell = {
                    "length": 40,
                    "start": start,
                    "seconds": seconds if goal == "map" else None,
                    "routes": {each: [[0.0, 0.0], [1.0, 1.0]] for each in known},
                    "scores": {
                        field: {
                            each: {measure: errors(field, each, start) for measure in measures}
                            for each in known
                        }
                    },
                }
                name = f"{goal}-{'square' if field == 'one' else field}-40-{start:02d}.json"
                (folder / CELLS / name).write_text(json.dumps(cell))


def verdicts(folder):
    return {aim.short: aim.verdict for aim in judged(League.read(folder))}


def test_aims_are_reached_where_all_errors_are_far_below(tmp_path):
    write_league(tmp_path, lambda field, method, start: (0.5 if "bojax" in method else 1.0) + 0.01 * start)
    assert set(verdicts(tmp_path).values()) == {REACHED}
    html, text = (path.read_text() for path in write_pages(tmp_path))
    assert all(aim.title in html for aim in judged(League.read(tmp_path)))
    assert "| one | 0.520 | 1.020 |  | 1.020 | 1.020 | 1.020 |" in text
    assert "Why aims are not reached" not in html + text
    assert (tmp_path / "figures" / "surveys-league-ratios.svg").exists()


def test_an_aim_that_is_not_reached_stands_with_its_reason(tmp_path):
    write_league(tmp_path, lambda field, method, start: 0.8 if method == "lawnmower" else 1.0, seconds=9.0)
    assert set(verdicts(tmp_path).values()) == {MISSED}
    html, text = (path.read_text() for path in write_pages(tmp_path))
    assert text.count("\n\nWhy aims are not reached, or inconclusive:\n\n- ") == 1
    for aim in judged(League.read(tmp_path)):
        assert aim.reason
        (row,) = (line for line in text.splitlines() if line.startswith(f"| {aim.short}: "))
        assert row.endswith("| **not reached** |")
        (row,) = (line for line in text.splitlines() if line.startswith(f"- {aim.short}: "))
        assert row[-1] == "." and f"<li>{aim.short}: " in html


def test_noise_leaves_an_aim_open(tmp_path):
    random = np.random.default_rng(0)
    write_league(tmp_path, lambda field, method, start: float(random.uniform(0.2, 2.0)))
    assert verdicts(tmp_path)["RMSE"] == OPEN


def test_a_ratio_is_of_sums_over_the_starts_that_both_have(tmp_path):
    write_league(tmp_path, lambda field, method, start: 1.0 + start if method == "bojax" else 2.0)
    (tmp_path / CELLS / "map-coast-40-04.json").unlink()
    found = League.read(tmp_path).ratio("rmse", "bojax", "lawnmower", ["one", "coast"], [40])
    assert found is not None
    interval, starts = found
    assert starts == 4
    assert interval.estimate == pytest.approx(np.mean([1, 2, 3, 4]) / 2.0)
    assert League.read(tmp_path).ratio("rmse", "bojax", "SGP-Tools", ["coast"], [40]) is None


def test_without_its_routes_an_aim_is_not_tested(tmp_path):
    write_league(tmp_path, lambda field, method, start: 1.0)
    for file in (tmp_path / CELLS).glob("hotspots-*"):
        file.unlink()
    assert verdicts(tmp_path)["hot spots"] == UNTESTED


def test_a_folder_without_results_is_one_line(tmp_path):
    with pytest.raises(ResultsError, match="no results of a league"):
        League.read(tmp_path)
