"""`bojax survey`: a route over an area, with its expected error beside that of the lawnmower."""

import argparse
import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bojax.cli.parser import Parser, UsageError, integer, path
from bojax.text import one_line

if TYPE_CHECKING:
    import numpy as np

    from bojax.areas.place import Place
    from bojax.surveys.goals import Goal

_EXAMPLES = """\
  bojax survey bay.geojson --budget 2km                     an optimised route, or the best lawnmower
  bojax survey depth.tif --below 0 --time 40min --speed 0.8 --start 10.21,54.37
  bojax survey 500x300 --spacing 20 --end 0,0               cover a rectangle with lines 20 m apart
  bojax survey bay.geojson --budget 2km --robots 2 --separation 20
  bojax survey bay.kml --avoid farm.kml --prior last_year.csv --budget 5km --out results/bay
"""

_DESCRIPTION = """\
Plan the route of a robot or a boat that maps a field over an area, such as depth or temperature. AREA is a
file of polygons (GeoJSON, KML), a raster whose cells without data are holes (GeoTIFF, NetCDF, ESRI ASCII,
XYZ, .npz, .npy, .csv), or a size in metres. Points are given in the coordinates of AREA: longitude and
latitude, or x and y. GeoTIFF, NetCDF and map projections need the extra geo."""

_UNITS = {"s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    args = _parser(name).read(words)
    budget = _budget(args)

    from bojax.results.folder import dated_folder, require_empty

    out = args.out or dated_folder("survey")
    require_empty(out)
    return plan(args, budget, out, shlex.join(["bojax", name, *words]))


def plan(args: argparse.Namespace, budget: float | None, out: Path, command: str) -> int:
    """Plan the survey that the arguments ask for, write its files, and return the exit code."""
    from bojax.engine.devices import prepare
    from bojax.engine.signals import kept

    with kept():
        prepare("auto")
        from bojax.areas.place import read_place
        from bojax.surveys.folder import write_survey
        from bojax.surveys.model import assumed_model, learned_model
        from bojax.surveys.planning import Demand, plan_survey
        from bojax.surveys.remarks import remarks

        try:
            place = read_place(args.area, args.below)
            for file in args.avoid:
                place = place.without(file)
            start, end = (
                _ends(given, option, args.robots, place)
                for option, given in (("start", args.start), ("end", args.end))
            )
            if args.prior is None:
                model = assumed_model(place.size, args.lengthscale)
            else:
                model = learned_model(args.prior, place, args.lengthscale)
            goal = _goal(args.goal, place)
            demand = Demand(
                budget, start, end, args.spacing, args.sampling, goal, args.robots, args.separation,
                args.turning_radius,
            )  # fmt: skip
            survey = plan_survey(place.area, model, demand, optimises=not args.lawnmower)
        except ValueError as error:
            raise UsageError(one_line(error)) from error
        for note in remarks(survey, demand, model, args.prior):
            place = place.noted(note)
        for note in place.notes:
            print(f"note: {note}")

    files = write_survey(out, place, model, survey, demand, args.speed, command)
    from bojax.report.surveying import build_survey_page, survey_summary

    page = build_survey_page(out)
    print(survey_summary(out))
    print(*files, page, sep="\n")
    return 0


def _ends(
    given: Sequence[tuple[float, float]], option: str, robots: int, place: "Place"
) -> "np.ndarray | None":
    """One point for all robots, or one for each, in metres of the place."""
    import numpy as np

    if len(given) not in (0, 1, robots):
        allowed = "one" if robots == 1 else f"one, or {robots}, one for each robot"
        raise UsageError(f"--{option}: got {len(given)} points; allowed: {allowed}")
    points = [place.point(point, f"--{option}") for point in given]
    return None if not points else points[0] if len(points) == 1 else np.array(points)


def _goal(given: tuple[str, str], place: "Place") -> "Goal":
    from bojax.surveys.goals import Goal

    kind, argument = given
    if kind == "threshold":
        return Goal(kind, threshold=float(argument))
    if kind == "region":
        return Goal(kind, region=place.region(argument))
    return Goal("hotspots" if kind == "hotspots" else "map")


def _budget(args: argparse.Namespace) -> float | None:
    """The maximum length in metres that the arguments ask for; None for none."""
    if (args.time is None) != (args.speed is None) and args.time is not None:
        raise UsageError("--time: needs --speed, in m/s")
    if args.time is not None and args.budget is not None:
        raise UsageError("--time: not with --budget; allowed: one of the two")
    return args.budget if args.time is None else args.time * args.speed


def _parser(name: str) -> Parser:
    parser = Parser(
        name,
        "AREA [--budget LENGTH | --time TIME --speed M/S] [--start X,Y] [--end X,Y]\n"
        "                    [--avoid FILE]... [--below V] [--prior FILE] [--lengthscale LENGTH]\n"
        "                    [--goal map|hotspots|threshold=V|region=FILE] [--spacing LENGTH]\n"
        "                    [--sampling LENGTH] [--robots N] [--separation LENGTH]\n"
        "                    [--turning-radius LENGTH] [--lawnmower] [--out DIR]",
        _DESCRIPTION,
        _EXAMPLES,
    )
    parser.option("area", "AREA", "file of the area, or a size such as 500x300 or 2kmx1km")
    parser.option(
        "--budget", "LENGTH", "length of the route, such as 2km or 800 (default: cover AREA)", _length
    )
    parser.option("--time", "TIME", "duration instead, such as 40min or 1h30min; needs --speed", _duration)
    parser.option("--speed", "M/S", "speed of the robot, m/s", _positive)
    parser.option(
        "--start", "X,Y", "first point (default: free)", _point,
        action="append", default=[],
    )  # fmt: skip
    parser.option("--end", "X,Y", "last point (default: free)", _point, action="append", default=[])
    robots = "robots that survey at once, 1 to 4; --start and --end are for all, or repeated for each"
    parser.option("--robots", "N", robots, integer, default=1, choices=range(1, 5))
    apart = "least distance of two robots at equal times, but for twice as far at a common start or end"
    parser.option("--separation", "LENGTH", apart, _length, default=0.0)
    avoid = "no-go zones: polygons, or a raster with data in them; may be repeated"
    parser.option("--avoid", "FILE", avoid, action="append", default=[])
    parser.option("--below", "V", "of a raster, only cells with values below V: 0 for the sea", _number)
    prior = "earlier survey of the field, from which the model is learned: raster, or x, y and value"
    parser.option("--prior", "FILE", prior)
    goal = "places that count: all, the highest tenth, those near a value, or a region (default: map)"
    parser.option("--goal", "GOAL", goal, _goal_words, default=("map", ""))
    scale = "distance over which values are alike (default: learned, or a tenth of AREA's root)"
    parser.option("--lengthscale", "LENGTH", scale, _length)
    lines = "least distance between two lines (default without a budget: the lengthscale)"
    parser.option("--spacing", "LENGTH", lines, _length)
    sampling = "distance between two measurements (default: a fifth of the lengthscale)"
    parser.option("--sampling", "LENGTH", sampling, _length)
    turns = "least radius of the turns of the route (default: turns on the spot)"
    parser.option("--turning-radius", "LENGTH", turns, _length, default=0.0)
    parser.flag("--lawnmower", "compare lawnmowers only, and optimise no route")
    parser.option("--out", "DIR", "new or empty folder (default: results/survey/TIME)", path)
    return parser


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"got {text}; allowed: a number")
    return value


def _positive(text: str) -> float:
    if not 0 < (value := _number(text)) < 1e9:
        raise argparse.ArgumentTypeError(f"got {text}; allowed: a number > 0 and < 1e9")
    return value


def _length(text: str) -> float:
    found = re.fullmatch(r"([\d.eE+-]+)\s*(km|m)?", text)
    if not found:
        raise argparse.ArgumentTypeError(f"got {text}; allowed: metres, or a length such as 2km or 800m")
    return _positive(found[1]) * (1000.0 if found[2] == "km" else 1.0)


def _duration(text: str) -> float:
    parts = re.findall(r"([\d.]+)\s*([a-z]+)\s*", text)
    if (
        not parts
        or "".join(a + b for a, b in parts) != text.replace(" ", "")
        or {u for _, u in parts} - _UNITS.keys()
    ):
        raise argparse.ArgumentTypeError(f"got {text}; allowed: a duration such as 40min, 90s or 1h30min")
    return sum(_positive(value) * _UNITS[unit] for value, unit in parts)


def _goal_words(text: str) -> tuple[str, str]:
    from bojax.surveys.goals import parse_goal

    try:
        return parse_goal(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _point(text: str) -> tuple[float, float]:
    cells = text.split(",")
    if len(cells) != 2:
        raise argparse.ArgumentTypeError(f"got {text}; allowed: two numbers, x,y or longitude,latitude")
    return _number(cells[0]), _number(cells[1])
