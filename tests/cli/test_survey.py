"""`bojax survey`: from a file to waypoints and a page, and mistakes in one line."""

import csv
import json
import os
import signal
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

pytest.importorskip("pyproj")
pytest.importorskip("rasterio")

from bojax.cli.main import main
from bojax.config.sweep import load_config, load_sweep
from bojax.config.yaml_file import read_mapping
from bojax.engine.build import build
from bojax.experiments.planning import PlanningEpisode
from bojax.report import style, surveying
from bojax.report.surveying import _distance, survey_summary
from bojax.surveys import model, planning, simulated
from bojax.surveys.remarks import remarks
from bojax.surveys.route import RouteOptions
from bojax.surveys.team import least_distance
from bojax.surveys.turns import least_radius
from tests.areas.test_place import HOLE, OUTER, geojson
from tests.fields.test_raster_files import write_tif
from tests.runs import run, tables
from tests.surveys.test_model import notes_of
from tests.transcript import cases


@pytest.fixture(autouse=True)
def little_work(monkeypatch):
    """Few steps of few routes on coarse grids: what the optimiser finds is tested in tests/surveys."""
    options = partial(RouteOptions, restarts=5, steps=10, models=2)
    monkeypatch.setattr(planning, "RouteOptions", options)
    monkeypatch.setattr(planning, "GRID_POINTS", 300)
    monkeypatch.setattr(planning, "MOST_SAMPLES", 120)
    monkeypatch.setattr(simulated, "CELLS", 12)


def with_hole() -> np.ndarray:
    values = np.add.outer(np.sin(np.arange(40) / 5.0), np.cos(np.arange(50) / 7.0))
    values[10:20, 10:30] = np.nan
    return values


def write_ascii(path) -> str:
    rows = [" ".join(map(str, np.where(np.isnan(row), -9999.0, row))) for row in with_hole()]
    header = "ncols 50\nnrows 40\nxllcorner 0\nyllcorner 0\ncellsize 2\nNODATA_value -9999\n"
    path.write_text(header + "\n".join(rows))
    return str(path)


def planned(out, *words: str) -> dict:
    """What `bojax survey` wrote about a plan."""
    assert main(["survey", *words, "--out", str(out)]) == 0
    return json.loads((out / "survey.json").read_text())


BUDGET = ("300x200", "--budget", "600")


def rows_of(folder, name: str = "waypoints.csv") -> dict[str, np.ndarray]:
    with (folder / name).open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def route_in(folder) -> np.ndarray:
    rows = rows_of(folder)
    return np.stack([rows["x"], rows["y"]], axis=1)


def test_a_geojson_with_a_hole(tmp_path, capsys):
    (tmp_path / "bay.geojson").write_text(geojson(OUTER, HOLE))
    out = tmp_path / "out"
    words = ["--time", "1h", "--speed", "1.5", "--start", "10.001,54.001", "--end", "10.019,54.009"]
    planned(out, str(tmp_path / "bay.geojson"), *words)
    assert "The best of" in capsys.readouterr().out
    rows = rows_of(out)
    assert rows["distance"][-1] <= 5400.0 + 1e-3
    np.testing.assert_allclose([rows["longitude"][0], rows["latitude"][0]], [10.001, 54.001], atol=1e-6)
    np.testing.assert_allclose([rows["longitude"][-1], rows["latitude"][-1]], [10.019, 54.009], atol=1e-6)
    line = shapely.from_geojson((out / "waypoints.geojson").read_text())
    assert shapely.covers(shapely.Polygon(OUTER, [HOLE]).buffer(1e-6), line)
    plan = json.loads((out / "waypoints.plan").read_text())
    places = [item["params"][4:6] for item in plan["mission"]["items"]]
    degrees = np.stack([rows["latitude"], rows["longitude"]], axis=1)
    np.testing.assert_allclose(places, degrees, atol=1e-7)
    route = ElementTree.parse(out / "waypoints.gpx").findall("{*}rte/{*}rtept")
    places = [[float(point.attrib[name]) for name in ("lat", "lon")] for point in route]
    np.testing.assert_allclose(places, degrees, atol=1e-7)
    assert "data:image/svg" in (out / "report.html").read_text()
    assert (out / "figures" / "route.png").is_file()


def test_an_ascii_raster_is_covered(tmp_path):
    out = tmp_path / "out"
    survey = planned(out, write_ascii(tmp_path / "a.asc"), "--spacing", "10")
    assert survey["candidates"][0]["length"] == min(each["length"] for each in survey["candidates"])
    line = shapely.LineString(route_in(out))
    rows, columns = np.nonzero(~np.isnan(with_hole()[::-1]))
    cells = np.stack([1.0 + 2.0 * columns, 1.0 + 2.0 * rows], axis=1)
    assert shapely.distance(line, shapely.points(cells)).max() < 10.0


def test_two_robots_keep_their_budgets_ends_and_distance(tmp_path):
    out = tmp_path / "out"
    words = ["--budget", "500", "--robots", "2", "--separation", "10", "--end", "150,0"]
    survey = planned(out, "300x200", *words, "--start", "0,0", "--start", "300,0")
    routes = [np.array(route) for route in survey["candidates"][0]["routes"]]
    for number, route in enumerate(routes, start=1):
        rows = rows_of(out, f"waypoints-{number}.csv")
        np.testing.assert_allclose(np.stack([rows["x"], rows["y"]], axis=1), route, atol=1e-3)
        np.testing.assert_allclose(route[[0, -1]], [[300.0 * (number - 1), 0.0], [150.0, 0.0]], atol=1e-6)
        assert rows["distance"][-1] <= 500.0 + 1e-3
    assert least_distance(routes, 10.0) >= 10.0
    assert survey["settings"]["robots"].startswith("2")
    mowers = [each for each in survey["candidates"] if each["method"] == "lawnmower"]
    assert len(mowers) >= 8 and all(len(each["routes"]) == 2 for each in mowers)
    assert survey["candidates"][0]["errors"][-1] <= mowers[0]["errors"][-1]
    assert survey["rule"].endswith(" Last are those that come closer than the separation.")


def test_the_least_expected_error_over_a_region_is_proposed_and_curves_fall(tmp_path):
    corners = [[200, 100], [300, 100], [300, 300], [200, 300], [200, 100]]
    (tmp_path / "part.geojson").write_text(geojson(corners, crs=None))
    out = tmp_path / "out"
    survey = planned(out, *BUDGET, "--goal", f"region={tmp_path / 'part.geojson'}")
    with np.load(out / "survey.npz") as arrays:
        assert arrays["grid"].min(0)[0] > 200.0 and arrays["grid"].min(0)[1] > 100.0
    middle = np.median(route_in(out), axis=0)
    assert middle[0] > 200.0 and middle[1] > 100.0
    candidates = survey["candidates"]
    assert any(each["detail"].endswith("over the region") for each in candidates)
    assert survey["goal"]["meaning"] == "over the region"
    assert candidates[0]["errors"][-1] == min(each["errors"][-1] for each in candidates)
    for each in candidates:
        assert np.all(np.diff(each["errors"]) <= 1e-12)
        assert each["errors"][0] == pytest.approx(1.0) and each["length"] <= 600.0 + 1e-6
    assert not (out / "waypoints.plan").exists()  # no place on the Earth
    assert json.loads((out / "waypoints.geojson").read_text())["crs"] is None


def test_a_threshold_weighs_places_by_an_earlier_survey_of_a_geotiff_with_holes(tmp_path, monkeypatch):
    monkeypatch.setattr(planning, "GRID_POINTS", 1500)  # few places may be at the threshold
    sloping = with_hole() / 5.0 + np.arange(50) / 5.0
    sloping += 0.3 * np.random.default_rng(1).standard_normal(sloping.shape)
    file, out = write_tif(tmp_path / "bay.tif", sloping), tmp_path / "out"
    words = ["--prior", file, "--budget", "1500", "--lawnmower", "--goal", "threshold=2.5"]
    survey = planned(out, file, *words)
    assert "learned from 200 values of bay.tif" in survey["settings"]["model"]
    assert rows_of(out)["distance"][-1] <= 1500.0 + 1e-3
    with np.load(out / "survey.npz") as arrays:
        weights, across, read = arrays["weights"], arrays["grid"][:, 0], arrays["read_0"]
    across = (across - across.min()) / np.ptp(across)
    assert weights.mean() == pytest.approx(1.0)
    assert np.average(across, weights=weights) == pytest.approx(0.25, abs=0.1)  # where the field is 2.5
    assert weights[across > 0.6].max() == 0.0
    assert (out / "figures" / "goal.png").is_file()
    # The file is AREA and --prior, and drawn once: all cells with data, whose value grows with x.
    assert sorted(path.name for path in (out / "figures").glob("read*.png")) == ["read-1.png"]
    np.testing.assert_allclose(np.sort(read[:, 2]), np.sort(sloping[~np.isnan(sloping)]), rtol=1e-6)
    assert np.corrcoef(read[:, 0], read[:, 2])[0, 1] > 0.9


def test_an_area_and_an_earlier_survey_are_both_drawn(tmp_path, monkeypatch):
    labels, draw_scale = [], surveying.draw_scale

    def draw(*args, label, **options):
        labels.append(label)
        return draw_scale(*args, label=label, **options)

    monkeypatch.setattr(surveying, "draw_scale", draw)
    prior, out = tmp_path / "prior.csv", tmp_path / "out"
    rows = np.random.default_rng(0).uniform(0.0, 80.0, (200, 3))  # as many as the model of other tests
    prior.write_text("x,y,Salt (PSU)\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    planned(out, write_ascii(tmp_path / "a.asc"), "--prior", str(prior), "--budget", "300", "--lawnmower")
    with np.load(out / "survey.npz") as arrays:
        assert len(arrays["read_0"]) == np.sum(~np.isnan(with_hole()))
        np.testing.assert_allclose(arrays["read_1"], rows)
    text = (out / "report.html").read_text()
    assert "What was read from a.asc" in text and "What was read from prior.csv" in text
    assert labels[1:] == ["value", "Salt (PSU)"]


def test_without_an_earlier_survey_hot_spots_are_everywhere(tmp_path, capsys):
    survey = planned(tmp_path / "out", *BUDGET, "--goal", "hotspots", "--lawnmower")
    assert "note: All places count alike: without --prior," in capsys.readouterr().out
    assert any("All places count alike" in text for text in survey["settings"].values())


MISTAKES = """\
100x100 --budget far
=> --budget: got far; allowed: metres, or a length such as 2km or 800m
100x100 --time 1h
=> --time: needs --speed, in m/s
100x100 --time 1h --speed 1 --budget 5
=> --time: not with --budget
100x100 --time '1 week' --speed 1
=> --time: got 1 week; allowed: a duration such as 40min
100x100 --start 5
=> --start: got 5; allowed: two numbers
100x100 --start -3.2,5
=> --start: got -3.2,5, which is not in the area
100x100 --start 500,5
=> --start: got 500,5, which is not in the area
100x100 --start 1,5 --end 99,5 --budget 50
=> budget: got 50 m, but the shortest way
100x100 --below 0
=> 100x100: has no values; allowed with --below: a raster
100x100 --robots 5
=> --robots: invalid choice: 5
100x100 --robots two
=> --robots: got two; allowed: an integer
100x100 --robots 3 --start 1,1 --start 2,2
=> --start: got 2 points; allowed: one, or 3, one for each robot
100x100 --turning-radius 60
=> turning radius: got 60 m, with which no lawnmower stays in the area; allowed: a smaller one, or lines
100x100 --turning-radius -1
=> --turning-radius: got -1; allowed: a number > 0
100x100 --goal depth
=> --goal: got depth; allowed: map, hotspots, threshold=V or region=
100x100 --goal threshold=deep
=> --goal: got threshold=deep; allowed: threshold=V, where
100x100 --goal region=no.kml
=> no.kml: No such file or directory
no.tif
=> no.tif: No such file or directory
100x100 --prior no.csv
=> no.csv: No such file or directory
100x100 --avoid no.kml
=> no.kml: No such file or directory
"""


def test_mistakes_are_one_line_and_write_nothing(here, refusal):
    for words, message in cases(MISTAKES):
        assert refusal(f"survey {words}").startswith(message)


def test_a_line_goes_on_across_the_date_line(tmp_path):
    corners = [[179.99, 10.0], [180.01, 10.0], [180.01, 10.01], [179.99, 10.01]]
    (tmp_path / "strait.geojson").write_text(geojson(corners))
    planned(out := tmp_path / "out", str(tmp_path / "strait.geojson"), "--spacing", "200")
    line = shapely.from_geojson((out / "waypoints.geojson").read_text())
    west, south, east, north = line.bounds
    assert 179.99 <= west < 180.0 < east <= 180.01 and 10.0 <= south < north <= 10.01
    table = np.genfromtxt(out / "waypoints.csv", delimiter=",", names=True)
    assert table["longitude"].min() < -179.98 and table["longitude"].max() > 179.98


def test_starts_and_ends_in_several_parts_are_refused(here, refusal):
    parts = [[[x, 0.0], [x + 10.0, 0.0], [x + 10.0, 10.0], [x, 10.0]] for x in (0.0, 20.0)]
    parts = {"type": "MultiPolygon", "coordinates": [[part] for part in parts], "crs": None}
    (here / "parts.json").write_text(json.dumps(parts))
    for words in ("--start 1,1 --end 25,5", "--start 1,1 --start 25,5 --robots 2 --budget 50"):
        message = refusal(f"survey parts.json {words}")
        assert message.startswith("the starts and ends lie in several parts of the area; allowed: points")


def test_an_interrupt_while_a_survey_is_planned_leaves_no_folder(tmp_path, monkeypatch):
    def interrupted(*given, **options):
        os.kill(os.getpid(), signal.SIGINT)
        return plan(*given, **options)

    plan = planning.plan_survey
    monkeypatch.setattr(planning, "plan_survey", interrupted)
    assert main(["survey", "100x100", "--lawnmower", "--out", str(tmp_path / "out")]) == 130
    assert not (tmp_path / "out").exists()


def test_an_earlier_survey_must_vary(here, refusal):
    (here / "flat.csv").write_text("x,y,z\n" + "\n".join(f"{i},{i % 7},3" for i in range(30)))
    (here / "few.csv").write_text("x,y,z\n1,2,3\n")
    (here / "place.csv").write_text("x,y,z\n" + "\n".join(f"50,60,{i % 7}" for i in range(30)))
    for file, message in (
        ("flat.csv", "all values are 3"),
        ("few.csv", "got 1 values; allowed: at least 10"),
        ("place.csv", "all values lie at one place"),
    ):
        assert refusal(f"survey 100x100 --prior {file}").startswith(f"{file}: {message}")


def test_an_earlier_survey_elsewhere_is_named(here, monkeypatch):
    away = "no value lies in the area, and the nearest is 4.9 km away: the model is learned from a field "
    away += "elsewhere."
    for at, expected in ((20.0, []), (5000.0, [f"old.csv: {away}"])):
        rows = [f"{at + i},{i % 7},{i % 5 - 9}" for i in range(30)]
        (here / "old.csv").write_text("x,y,z\n" + "\n".join(rows))
        assert [*notes_of(monkeypatch, "old.csv", "100x100")] == expected


def found(best: str, *errors: float) -> dict:
    """A survey whose best route is of this method, with the error of its best route and of the other's."""
    route = {"name": "route, optimised", "method": "route", "detail": "optimised", "length": 2500.0}
    mower = {"name": "lawnmower", "method": "lawnmower", "detail": "lines at 0°", "length": 2294.0}
    rest = mower | {"detail": "lines at 90°", "errors": [1.0, 0.9]}
    pair = [route, mower] if best == "route" else [mower, route]
    candidates = [each | {"errors": [1.0, error]} for each, error in zip(pair, errors, strict=True)]
    common = {"routes": [[], []], "distances": [0.0, 2000.0]}
    return {
        "candidates": [each | common for each in [*candidates, rest]],
        "goal": {"meaning": "over the area"},
    }


def test_the_error_of_the_best_lawnmower_is_named_with_its_length_or_that_it_comes_too_close(tmp_path):
    for error, end in (
        (0.18, " 10.0% less than the best lawnmower (0.200, 2.29 km long)."),
        (0.3, "The best lawnmower leaves less, 0.200, but its robots come closer than asked."),
    ):
        (tmp_path / "survey.json").write_text(json.dumps(found("route", error, 0.2)))
        assert survey_summary(tmp_path).endswith(end)


@pytest.mark.parametrize("best", ["route", "lawnmower"])
def test_the_legend_names_the_best_of_both_methods_and_hides_no_curve(best):
    with style.settings():
        figure = surveying._draw_errors(found(best, 0.2, 0.3)).figure
        figure.draw_without_rendering()
    (axes,) = figure.axes
    legend = axes.get_legend()
    names = ["route, optimised", "best lawnmower (lines at 0°)"]
    assert [text.get_text() for text in legend.get_texts()] == (names[::-1] if best == "route" else names)
    assert legend.get_window_extent().y0 >= axes.get_window_extent().y1


def test_the_border_is_drawn_above_the_cells_of_a_map():
    ring = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 0.0]])
    maps = {"outline": ring, "ring_ends": np.array([4]), "grid": np.ones((1, 2)), "after": np.ones(1)}
    with style.settings():
        _, axes, _ = surveying._draw_map({"grid_spacing": 1.0}, maps, "after", "deviation")
    (cells,), (border,) = axes.collections, axes.patches
    assert cells.get_zorder() < border.get_zorder()


def check_planners(config, sweep) -> None:
    """The planners of a config and of a sweep fit the one problem of both, which is built once."""
    points = load_config(str(config)).points + load_sweep(str(sweep)).points
    problem = build(points[0].config.problem)
    for point in points:
        assert point.config.problem == points[0].config.problem
        PlanningEpisode(problem, build(point.config.planner))


def test_the_config_of_a_survey_has_its_area_and_its_ends(tmp_path):
    hole = [[80, 60], [200, 60], [200, 120], [80, 120], [80, 60]]
    border = [[0, 0], [300, 0], [300, 200], [0, 200], [0, 0]]
    (tmp_path / "pond.geojson").write_text(geojson(border, hole, crs=None))
    out, runs = tmp_path / "survey", tmp_path / "runs"
    words = ["--budget", "900", "--lengthscale", "60", "--start", "20,90", "--end", "280,90", "--lawnmower"]
    survey = planned(out, str(tmp_path / "pond.geojson"), *words)
    planners = read_mapping(out / "planners.yaml", "")["axes"]["planner"]
    assert [*planners] == ["route", "lawnmower", "kcbts", "cbts", "sbo", "myopic", "random"]
    check_planners(out / "simulation.yaml", out / "planners.yaml")
    for name, stops, resolution in (("lawnmower", False, 121), ("random", True, 31)):
        changed = [
            f"planner.{key}={json.dumps(value)}" for key, value in planners[name].items() if key != "kind"
        ]
        words = [
            f"planner={planners[name]['kind']}",
            *changed,
            f"problem.resolution={resolution}",
            "--runs",
            "2",
        ]
        found, steps = tables(run(runs / name, str(out / "simulation.yaml"), *words))
        assert found["success"] == [True, True] and max(steps["distance"]) <= 900.0 + 1e-6
        assert bool(sum(found["collisions"])) == stops
        last = [(x, y) for x, y, done in zip(steps["x"], steps["y"], steps["done"], strict=True) if done]
        np.testing.assert_allclose(last, [(280.0, 90.0)] * 2, atol=1e-6)
    # What the survey expects of the lawnmower is what its simulation finds. A coarse grid has a larger share
    # of points at the border, where the deviation is larger.
    expected = survey["candidates"][0]["errors"][-1]
    (found,) = tables(runs / "lawnmower", "runs")
    assert found["mean_std"] == pytest.approx([expected] * 2, rel=0.02)


def test_each_robot_of_a_survey_has_a_config_that_runs_alone(tmp_path, capsys):
    out = tmp_path / "survey"
    words = ["--budget", "500", "--lengthscale", "60", "--robots", "2", "--separation", "20", "--lawnmower"]
    ends = ["--start", "0,0", "--start", "300,0", "--end", "150,0"]
    planned(out, "300x200", *words, *ends)
    assert (
        "note: simulation-N.yaml has robot N alone, without what others measure." in capsys.readouterr().out
    )
    for number, start in ((1, [0.0, 0.0]), (2, [300.0, 0.0])):
        config = out / f"simulation-{number}.yaml"
        assert "what the others of this survey measure does not count" in config.read_text()
        content = read_mapping(config, "")
        assert f"by robot {number} of 2 alone" in content["title"]
        assert content["problem"]["start"][:2] == start and content["problem"]["end"] == [150.0, 0.0]
        assert content["planner"]["file"] == str(out / f"waypoints-{number}.csv")
        check_planners(config, out / f"planners-{number}.yaml")
        found, steps = tables(run(tmp_path / f"runs-{number}", str(config), "--runs", "1"))
        assert found["success"] == [True] and found["collisions"] == [0] and found["exits"] == [0]
        assert max(steps["distance"]) <= 500.0 + 1e-6


@pytest.mark.parametrize("plan", ["--budget 700", "--spacing 30"])
def test_the_turns_that_are_written_have_the_radius(tmp_path, plan):
    out = tmp_path / "out"
    area = write_ascii(tmp_path / "a.asc")
    settings = planned(out, area, *plan.split(), "--turning-radius", "6m")["settings"]
    assert least_radius(route_in(out)) > 5.95  # written to a millimetre
    assert settings["turning radius"].startswith("6 m; the tightest turn has 6")
    assert ("left out for the turns" in settings) == (plan == "--spacing 30")


REMARKS = """\
length=5
=> Nothing is measured: the proposed route is shorter than 10 m, the distance between two measurements
   (--sampling).
length=40 budget=100 turning_radius=60
=> Only 40 m (40%) of the budget of 100 m are used: no longer route that was tried has turns of 60 m in the
   area.
length=40 budget=100 spacing=50
=> Only 40 m (40%) of the budget of 100 m are used: lines are not closer than --spacing, 50 m. --spacing: with
   a budget, it is only the least distance between the lines of lawnmowers.
length=60 left_out=0.2 turning_radius=6
=> The proposed lawnmower leaves out 20% of its waypoints, since they leave too little room for turns of 6 m.
length=60 separation=5
=> --separation: one robot does not use it.
"""


def test_what_a_survey_does_not_use_or_measure_is_named():
    for words, expected in [("length=60 budget=100", ""), *cases(REMARKS)]:
        given = {name: float(value) for name, value in (word.split("=") for word in words.split())}
        route = np.array([[0.0, 0.0], [given.pop("length"), 0.0]])
        none = np.zeros(0)
        chosen = planning.Candidate("lawnmower", "", (route,), none, none, given.pop("left_out", 0.0))
        survey = planning.Survey((chosen,), none, 1.0, none, none, none, 10.0, None, share=1.0)
        field = model.assumed_model(1e4, None)
        assert " ".join(remarks(survey, planning.Demand(**given), field, None)) == expected


def test_a_budget_of_which_lawnmowers_use_little_is_named(tmp_path, capsys, monkeypatch):
    for module in ("lawnmower", "remarks"):
        monkeypatch.setattr(f"bojax.surveys.{module}.MOST_LINES", 1000)
    survey = planned(tmp_path / "out", "300x110", "--budget", "9e8", "--lawnmower")
    length = survey["candidates"][0]["length"]
    used = f"Only {length:.4g} m ({100 * length / 9e8:.2g}%) of the budget of 9e+08 m are used"
    assert f"note: {used}: more than 1,000 lines are not tried.\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("metres", "shown"), [(812.4, "812 m"), (999.4, "999 m"), (999.6, "1.00 km"), (1000.0, "1.00 km")]
)
def test_a_length_below_a_kilometre_has_no_exponent(metres, shown):
    assert _distance(metres) == shown


def test_errors_are_those_of_a_route_that_is_far_shorter_than_the_budget(tmp_path):
    errors = []
    for budget in ("100km", "300"):
        words = ["--budget", budget, "--spacing", "80", "--lawnmower"]
        planned(tmp_path / budget, "100x100", *words)
        candidates = json.loads((tmp_path / budget / "survey.json").read_text())["candidates"]
        errors.append([candidates[0]["length"], candidates[0]["errors"][-1]])
    assert errors[0][0] < 200.0 and errors[0][1] < 0.9
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)
