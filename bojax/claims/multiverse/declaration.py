"""The file of a multiverse analysis: sweeps with claims, and the choices that their paper leaves open."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import pydantic
from pydantic import Field

from bojax.claims.multiverse.designs import fractional, grid, random
from bojax.config.claims import Claim
from bojax.config.component import Schema
from bojax.config.errors import ConfigError, dotted, from_validation, listed, shown
from bojax.config.files import SUFFIXES, display, find, shipped
from bojax.config.overrides import SOURCE
from bojax.config.points import Point, Sweep
from bojax.config.sweep import Setting, vary
from bojax.config.yaml_file import read_mapping

AXIS = "configuration"
"""Column of the tables that has the number of the configuration."""

FOLDER = "sweeps/multiverse"


class ChoiceEntry(Schema, frozen=True):
    """One choice that a paper leaves open, with the values that its author could have chosen."""

    says: str = Field(description="what is open, in one line")
    source: str = Field(description="where the paper leaves it open, and why these values")
    of: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="labels or variants of the points that the choice is about; by default all points that "
        "have the setting",
    )
    not_of: tuple[str, ...] = Field(
        default=(), strict=False, description="labels or variants of points that the choice is not about"
    )
    sweeps: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="sweeps that the choice is about; by default, all of the analysis",
    )
    setting: str | None = Field(
        default=None, min_length=1, description="dotted path of the setting, if values is a list"
    )
    values: list[Any] | dict[str, dict[str, Any]] = Field(
        description="values of the setting, or named values that each change several settings; the first is "
        "that of the sweep"
    )

    @pydantic.model_validator(mode="after")
    def _list_of_a_setting(self) -> Self:
        if isinstance(self.values, list) and self.setting is None:
            raise ValueError("setting: missing; allowed: the path whose values are listed")
        if isinstance(self.values, dict) and self.setting is not None:
            raise ValueError("setting: not allowed beside named values, which name the settings")
        if len(self.values) < 2:
            raise ValueError("values: got one; allowed: at least two")
        if len(set(self.names)) < len(self.values):
            raise ValueError("values: got a value twice; allowed: distinct values")
        return self

    @property
    def names(self) -> list[str]:
        """The names of the values."""
        if isinstance(self.values, dict):
            return list(self.values)
        return [value if isinstance(value, str) else json.dumps(value) for value in self.values]

    def settings(self, level: int, sweep: str, origin: str) -> list[Setting]:
        """The settings of one of the values in a sweep; messages call the choice `origin`."""
        if self.sweeps and sweep not in self.sweeps:
            return []
        if isinstance(self.values, dict):
            changed = list(self.values.values())[level]
        else:
            changed = {str(self.setting): self.values[level]}
        return [
            Setting(tuple(path.split(".")), value, self.of, self.not_of, f"{origin}.{self.names[level]}")
            for path, value in changed.items()
        ]


class Design(Schema, frozen=True):
    """Which combinations of the choices are run."""

    kind: Literal["grid", "random", "fractional"] = Field(
        default="random",
        description="grid: all combinations; random: distinct combinations, each value equally likely; "
        "fractional: a regular fraction of the grid, in which the main effects are not confounded with each "
        "other, for choices of 2, 4, 8 ... values",
    )
    configurations: int | None = Field(
        default=None, ge=2, description="number of combinations, if the design is no grid"
    )
    seed: int = Field(default=0, ge=0, description="seed of a random design")

    @pydantic.model_validator(mode="after")
    def _number(self) -> Self:
        if (self.configurations is None) != (self.kind == "grid"):
            raise ValueError("configurations: needed by all designs but a grid, which has all of them")
        return self


class Confirmation(Schema, frozen=True):
    """Runs of the sweep's own and of the best configuration on fresh seeds."""

    runs: int = Field(default=200, ge=20, description="number of runs of each point")
    seed: int = Field(default=1, ge=0, description="seed, other than the one of the analysis")


class MultiverseFile(Schema, frozen=True):
    """A multiverse analysis."""

    title: str = Field(description="title of the page, one line")
    sweeps: tuple[str, ...] = Field(
        strict=False,
        min_length=1,
        description="sweeps whose claims are tested: names, or files beside this one",
    )
    choices: dict[str, ChoiceEntry] = Field(min_length=1, description="the choices, by name")
    design: Design = Field(default=Design(kind="grid"), description="which combinations are run")
    runs: int = Field(default=100, ge=20, description="number of runs of each point")
    seed: int = Field(default=0, ge=0, description="seed of all runs")
    block: int = Field(
        default=50, ge=1, description="number of configurations that are run as one plan, and then evaluated"
    )
    confirm: Confirmation = Field(default=Confirmation(), description="runs on fresh seeds")
    reading: str = Field(
        default="", description="a paragraph on the best configuration, such as its plausibility"
    )

    @pydantic.model_validator(mode="after")
    def _fresh_seed(self) -> Self:
        if self.confirm.seed == self.seed:
            raise ValueError(f"confirm.seed: got {self.seed}, the seed of the analysis; allowed: another one")
        return self


@dataclass(frozen=True)
class Declaration:
    """A multiverse analysis, read from its file and checked."""

    name: str  # name of the file without its suffix
    file: MultiverseFile  # its content
    path: Path  # the file

    @cached_property
    def configurations(self) -> list[tuple[int, ...]]:
        """The value of each choice, as an index, in each configuration; the first is the sweep's own."""
        sizes = [len(choice.values) for choice in self.file.choices.values()]
        design = self.file.design
        if design.kind == "grid":
            return grid(sizes)
        assert design.configurations is not None
        try:
            if design.kind == "random":
                return random(sizes, design.configurations, design.seed)
            return fractional(sizes, design.configurations)
        except ValueError as error:
            raise ConfigError(f"{display(self.path)}: design: {error}") from error

    @cached_property
    def choices_of_claims(self) -> dict[str, list[str]]:
        """The choices that change a point that a claim compares, by the id of the claim."""
        found: dict[str, list[str]] = {}
        for source in self.file.sweeps:
            tried, sweep = self.one_at_a_time(source)
            for claim in sweep.claims:
                numbers = [point.swept[AXIS].split() for point in sweep.points if _compares(claim, point)]
                changed = {number for each in numbers if "0" not in each for number in each}
                choices = [name for number, (name, _) in tried.items() if str(number) in changed]
                found[claim.id] = list(dict.fromkeys(choices))
        return found

    def one_at_a_time(self, source: str) -> tuple[dict[int, tuple[str, int]], Sweep]:
        """One of the sweeps under each value of each choice, all other choices as in the sweep.

        Returns the choice and the value of each configuration, from 1, and the sweep; 0 is the sweep's own.
        """
        choices = self.file.choices.items()
        values = [(name, level) for name, choice in choices for level in range(len(choice.values))]
        tried = dict(enumerate(values, start=1))
        variations = {
            number: self.file.choices[name].settings(level, source, f"{display(self.path)}: choices.{name}")
            for number, (name, level) in tried.items()
        }
        return tried, _with_claims_alone(vary(self.source_of(source), AXIS, {0: [], **variations}))

    def settings(self, sweep: str, levels: Sequence[int]) -> list[Setting]:
        """The settings of a configuration of one of the sweeps."""
        return [
            setting
            for (name, choice), level in zip(self.file.choices.items(), levels, strict=True)
            for setting in choice.settings(level, sweep, f"{display(self.path)}: choices.{name}")
        ]

    def sweep(self, source: str, numbers: Sequence[int], runs: int | None, seed: int | None) -> Sweep:
        """One of the sweeps, with its points once for each of these configurations, without recorded runs.

        It has the claims alone, and the points that they compare: a variant is a claim under other settings,
        which is what the choices are for.
        """
        variations = {number: self.settings(source, self.configurations[number]) for number in numbers}
        runs, seed = (self.file.runs if runs is None else runs), (self.file.seed if seed is None else seed)
        varied = _with_claims_alone(vary(self.source_of(source), AXIS, variations, runs, seed))
        return replace(varied, record=varied.record.model_copy(update={"runs": 0}), report={})

    def with_changes(self, changes: Mapping[str, Any]) -> "Declaration":
        """The analysis with another number of runs, also of those on fresh seeds, or another seed."""
        content = {**self.file.model_dump(mode="json"), **changes}
        if "runs" in changes:
            content["confirm"] = content["confirm"] | {"runs": changes["runs"]}
        try:
            file = MultiverseFile.model_validate(content)
        except pydantic.ValidationError as error:
            raise from_validation(error, lambda location: f"{SOURCE}: {dotted(location)}") from error
        return replace(self, file=file)

    def source_of(self, sweep: str) -> str:
        """A sweep of the file as a name, or as a path from the working directory."""
        if not sweep.endswith(SUFFIXES):
            return sweep
        return str(find(sweep, "sweeps", beside=[self.path.parent]))


def _with_claims_alone(sweep: Sweep) -> Sweep:
    """A sweep without its variants and checks, and without the points that no claim compares."""
    claims = tuple(claim for claim in sweep.claims if claim.entry_class == "claim")
    kept = [point for point in sweep.points if any(_compares(claim, point) for claim in claims)]
    if not kept:
        raise ConfigError(f"{display(sweep.source)}: claims: none is of class claim; allowed: at least one")
    return replace(
        sweep,
        claims=claims,
        points=tuple(replace(point, index=index) for index, point in enumerate(kept)),
        locate=lambda index, location: sweep.locate(kept[index].index, location),
    )


def _compares(claim: Claim, point: Point) -> bool:
    return (point.label if claim.test.by == "label" else point.variant) in claim.test.names


def declared(source: str) -> Declaration:
    """The analysis of a file, or of a name in `sweeps/multiverse`, all of whose values were tried."""
    path = _find(source)
    where = display(path)
    try:
        file = MultiverseFile.model_validate(dict(read_mapping(path, where)))
    except pydantic.ValidationError as error:
        raise from_validation(error, lambda location: f"{where}: {dotted(location)}") from error
    declaration = Declaration(path.stem, file, path)
    _check_choices(declaration, where)
    _ = declaration.configurations
    return declaration


def names() -> dict[str, Path]:
    """The analyses that are part of bojax, by name."""
    return {path.stem: path for path in sorted((shipped("sweeps") / "multiverse").glob("*.yaml"))}


def _find(source: str) -> Path:
    if source.endswith(SUFFIXES):
        if not Path(source).is_file():
            raise ConfigError(f"{source}: no such file")
        return Path(source)
    known = names()
    if source not in known:
        raise ConfigError(f"{source}: no such name in {FOLDER}/; allowed: {listed(source, known)}, or a file")
    return known[source]


def _check_choices(declaration: Declaration, where: str) -> None:
    """Refuse a value that changes no point or equals another one, and a first one that changes the sweep."""
    sweeps = declaration.file.sweeps
    for name, choice in declaration.file.choices.items():
        for source in choice.sweeps:
            if source not in sweeps:
                raise ConfigError(
                    f"{where}: choices.{name}.sweeps: got {shown(source)}; allowed: {listed(source, sweeps)}"
                )
    used: set[tuple[str, int]] = set()
    given: dict[tuple[str, int], list[tuple[str, int]]] = {}  # sweep and index of the points of each value
    for source in sweeps:
        tried, varied = declaration.one_at_a_time(source)
        points = [(point.swept[AXIS].split(), point.variant) for point in varied.points]
        for number, (name, level) in tried.items():
            own = [index for index, (numbers, _) in enumerate(points) if str(number) in numbers]
            changed = [points[index][1] for index in own if "0" not in points[index][0]]
            if changed and level == 0:
                raise ConfigError(
                    f"{where}: choices.{name}.values: the first changes {changed[0]} of {source}; allowed: "
                    "first the value of the sweep itself"
                )
            if changed:
                used.add((name, level))
            given.setdefault((name, level), []).extend((source, index) for index in own)
    if unused := [choice for choice in given if choice[1] > 0 and choice not in used]:
        name, level = min(unused)
        value = declaration.file.choices[name].names[level]
        raise ConfigError(
            f"{where}: choices.{name}: got {shown(value)}, which changes no point of "
            f"{', '.join(sweeps)} that a claim compares; allowed: settings that such a point has"
        )
    for (name, level), points in given.items():
        names = declaration.file.choices[name].names
        for earlier in range(level):
            if given[name, earlier] == points:
                equal = f"{shown(names[earlier])} and {shown(names[level])}"
                raise ConfigError(
                    f"{where}: choices.{name}: got {equal}, which are equal; allowed: distinct values"
                )
