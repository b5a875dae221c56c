"""The results of a sweep as Python objects: Arrow tables, claims and figures."""

import base64
import html
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
from matplotlib.figure import Figure
from typing_extensions import override

from bojax.api.errors import BojaxError, in_one_line
from bojax.api.plain_values import path_of
from bojax.config.errors import allowed_names, did_you_mean
from bojax.config.figures import FIGURES
from bojax.config.yaml_file import read_mapping
from bojax.report import source, style
from bojax.report.drawing.base import FigureUnavailable
from bojax.report.figures import draw
from bojax.report.page import summary
from bojax.report.ranking import best_of, config_of, measure_of
from bojax.report.verdicts import read_claims
from bojax.results.store import LEARNERS, read_manifest, read_table
from bojax.tuning.page import read_tuning
from bojax.tuning.ranges import described

if TYPE_CHECKING:
    from bojax.engine.policies import Policy

_CLAIMS = pa.schema(
    [(name, pa.string()) for name in ("id", "source", "claim", "thesis", "ours")]
    + [("low", pa.float64()), ("high", pa.float64()), ("runs", pa.int64()), ("verdict", pa.string())]
)


def load(folder: str | os.PathLike[str]) -> "Results":
    """The results in a folder that `bojax run` or `bojax sweep` wrote.

    Raises:
        BojaxError: The folder holds no finished results, or they are damaged.
    """
    with in_one_line():
        found = source.load(Path(path_of(folder, "folder")))
    # Tables are read when they are asked for, which may be in another working directory.
    return Results(replace(found, folder=found.folder.absolute()))


@dataclass(frozen=True)
class Picture:
    """A figure of a report; a notebook shows it with its caption.

    Attributes:
        figure: The figure of matplotlib.
        title: Its title.
        caption: What it shows, and how that was computed.
        alt: Alternative text for screen readers.
        png: The same as an image.
    """

    figure: Figure
    title: str
    caption: str
    alt: str
    png: bytes

    @override
    def __repr__(self) -> str:
        return f"{self.title}: {self.caption}"

    def _repr_png_(self) -> bytes:
        return self.png

    def _repr_html_(self) -> str:
        image = base64.b64encode(self.png).decode("ascii")
        title, caption, alt = map(html.escape, (self.title, self.caption, self.alt))
        return (
            f'<figure style="margin: 0; max-width: 40em"><b>{title}</b><br>'
            f'<img src="data:image/png;base64,{image}" alt="{alt}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )


class Results:
    """The results of a sweep. Tables are Arrow tables: `.to_pandas()`, or `polars.from_arrow(table)`.

    Tables and figures are read when they are asked for. The page "Results" of the documentation describes
    the columns.
    """

    def __init__(self, results: source.Results):
        self._results = results

    @property
    def folder(self) -> Path:
        """The results folder, as an absolute path."""
        return self._results.folder

    @cached_property
    def runs(self) -> pa.Table:
        """One row for each run, `runs.parquet`."""
        return self._table("runs")

    @cached_property
    def steps(self) -> pa.Table:
        """One row for each step, `steps.parquet`."""
        return self._table("steps")

    @cached_property
    def episodes(self) -> pa.Table:
        """One row for each episode of a learning experiment, `episodes.parquet`."""
        return self._table("episodes")

    @cached_property
    def timings(self) -> pa.Table:
        """One row for each segment of time, `timings.parquet`."""
        return self._table("timings")

    @cached_property
    def claims(self) -> pa.Table:
        """One row for each claim of the thesis with its verdict, from `claims.json`.

        `thesis` and `ours` are the values as the report prints them, `low` and `high` are the 95% interval.
        """
        with in_one_line():
            found = read_claims(self.folder)
        rows = []
        for claim in found:
            low, high = claim.interval or (None, None)
            texts = {"id": claim.id, "source": claim.source, "claim": claim.claim, "thesis": claim.printed}
            numbers = {"low": low, "high": high, "runs": claim.runs}
            rows.append({**texts, "ours": claim.found, **numbers, "verdict": claim.verdict})
        return pa.Table.from_pylist(rows, schema=_CLAIMS)

    @cached_property
    def manifest(self) -> Mapping[str, Any]:
        """`manifest.json`: settings of each point, command, versions, device, times."""
        with in_one_line():
            return read_manifest(self.folder)

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the experiment before the axes of a sweep are applied, as they were given."""
        return self.manifest.get("config", {})

    @property
    def report(self) -> Path:
        """The page with figures, tables and claims, `report.html`."""
        return self.folder / "report.html"

    def show(self, name: str | None = None) -> Picture:
        """Draw a figure.

        Args:
            name: Name of the figure, such as `"accumulated-reward"`; by default, the first of the report.

        Raises:
            BojaxError: There is no such figure, or the results do not allow it.
        """
        if name is not None and name not in FIGURES:
            raise BojaxError(
                f"unknown figure {name}; allowed: {', '.join(sorted(FIGURES))}{did_you_mean(name, FIGURES)}"
            )
        reason = "the report has no figure"
        for each in [name] if name else self._results.report.figures or FIGURES:
            if each not in FIGURES:  # a table
                continue
            try:
                with in_one_line(), style.settings():
                    drawing = draw(each, self._results)
                    png = drawing.files["png"]
                return Picture(drawing.figure, drawing.title, drawing.caption, drawing.alt, png)
            except FigureUnavailable as problem:
                reason = f"the figure {each} is not drawn: {problem}"
        raise BojaxError(f"{self.folder}: {reason}")

    def policy(self, point: int | str = 0, *, run: int = 0, seed: int = 0) -> "Policy":
        """What a run has learned, as a function: `action = results.policy()(observation)`.

        Observations and actions are those of the environment, so that the function works in any loop outside
        of bojax. It needs a learner that was saved, with `record={"learners": True}`. The settings of a saved
        learner may name modules, which are imported.

        Args:
            point: Number of the point of a sweep, or its name.
            run: Index of the run.
            seed: Seed of the random draws of the policy, which break ties or propose candidate actions.

        Raises:
            BojaxError: There is no such point, or no learner of the run was saved.
        """
        points = self._results.points
        names = {each.name: each.index for each in points} | {each.index: each.index for each in points}
        if point not in names:
            known = [each.name for each in points]
            raise BojaxError(f"{self.folder}: no point {point}{allowed_names(point, known)}")

        from bojax.engine.policies import saved_policy

        with in_one_line():
            return saved_policy(self.folder / LEARNERS / str(names[point]), run, seed)

    def best(self, by: str | None = None) -> dict[str, Any]:
        """The config of the best point of a sweep, with another seed: `bojax.run(results.best(), runs=200)`.

        The best of many points is chosen by its own runs, so that its mean over these runs is optimistic. The
        mean over new runs is not.

        Args:
            by: Column of `runs` whose mean decides, with a minus sign if less is better: `"-rmse"`. By
                default `report.rank_by`, or `"-steps_to_goal"` if a learner reached a goal, or `"return"`, of
                learners `"last_return"`.

        Raises:
            BojaxError: There is no such column of numbers.
        """
        with in_one_line():
            return config_of(self._results, best_of(self._results, measure_of(self._results, by)).point)

    @override
    def __repr__(self) -> str:
        with in_one_line():
            return f"{self._results.manifest.title}: {summary(self._results)} ({self.folder})"

    def _repr_html_(self) -> str:
        with in_one_line():
            title, text = html.escape(self._results.manifest.title), html.escape(summary(self._results))
        return f"<div><b>{title}</b><br>{text}<br><code>{html.escape(str(self.folder))}</code></div>"

    def _table(self, name: str) -> pa.Table:
        path = self.folder / f"{name}.parquet"
        if not path.exists():
            there = sorted(file.stem for file in self.folder.glob("*.parquet"))
            raise BojaxError(f"{self.folder}: no table {name}{allowed_names(name, there)}")
        with in_one_line():
            return read_table(path)


class TuningResults:
    """What a search over settings has found, in the folder that `bojax tune` wrote.

    Raises:
        BojaxError: The folder holds no finished search.
    """

    def __init__(self, folder: str | os.PathLike[str]):
        with in_one_line():
            self._tuning = read_tuning(Path(folder))
        self.folder = Path(folder).absolute()

    @cached_property
    def points(self) -> pa.Table:
        """One row for each point, the best expected score first.

        The columns are the tuned settings by dotted path, `round` from 0, `score`, the mean of the metric,
        and the posterior `mean` and `std` of the metric without noise. Points without a score are left out.
        """
        keys, rows = [each.key for each in self._tuning.ranges], []
        for point in (self._tuning.points[index] for index in self._tuning.order):
            rows.append(dict(zip(keys, point.values, strict=True)) | point.model_dump(exclude={"values"}))
        return pa.Table.from_pylist(rows)

    @cached_property
    def best(self) -> dict[str, Any]:
        """The config of the best point, with another seed: `bojax.run(found.best, runs=200)`."""
        with in_one_line():
            return read_mapping(self.folder / "best.yaml", "best.yaml")

    @property
    def confirmed(self) -> Results | None:
        """Results of the best points and of the config as given on fresh runs; None without fresh runs."""
        name = self._tuning.confirmed
        return None if name is None else load(self.folder / name)

    @property
    def report(self) -> Path:
        """The page with slices through the model, scores and fresh runs, `report.html`."""
        return self.folder / "report.html"

    @override
    def __repr__(self) -> str:
        words = described(self._tuning.ranges, self._tuning.best.values)
        return f"{self._tuning.title}: {self._tuning.measure.words} best at {words} ({self.folder})"
