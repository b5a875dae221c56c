"""The names by which `bojax reproduce` starts the sweeps of a figure, a table, a chapter or the thesis."""

import re
from pathlib import Path
from typing import Any

from bojax.config.errors import LIST, ConfigError, did_you_mean, listed
from bojax.config.files import available, display
from bojax.config.yaml_file import read_mapping

ALL = "all"
"""Name of all sweeps with claims of the thesis."""

CHAPTERS = {f"chapter{number}": f"{number}." for number in (3, 4, 5)}
"""The chapters of the thesis with results, and how the numbers of their figures begin."""

STUDY = "study-"
"""Prefix of sweeps that answer a question which the thesis leaves open."""

OTHERS = {"pomdp": "pomdp-"}
"""Groups of sweeps that reproduce results of others, and the prefixes of these sweeps."""

_FIGURE = re.compile(r"(?:fig|table)-\d+\.\d+(?=\D)")

_CITED = re.compile(r"(Fig\.|Table) (\d+\.\d+)")
"""A figure or table in the `source` of a claim."""


def sweeps_of(name: str) -> list[str]:
    """The sweeps that a name stands for: itself, or all of a figure, table, chapter, group or the thesis."""
    contents = _contents()
    meant = _meant(name, contents)
    if not meant:
        allowed = {*groups(), *contents}
        if name in available("configs"):
            raise ConfigError(f"got {name}, a config; start it with: bojax run {name}")
        raise ConfigError(f"got {name}; allowed: {listed(name, allowed, LIST)}{did_you_mean(name, allowed)}")
    return meant


def groups() -> dict[str, list[str]]:
    """The names of figures, tables, chapters, other groups and `all`, each with the sweeps it stands for."""
    contents = _contents()
    names = {match[0] for name in contents if (match := _FIGURE.match(name))}
    names = sorted(names.union(*(_figures(name, contents) for name in contents)) - contents.keys())
    return {name: _meant(name, contents) for name in (*names, *CHAPTERS, *OTHERS, ALL)}


def _meant(name: str, contents: dict[str, dict[str, Any]]) -> list[str]:
    """The sweeps that a name stands for, without aliases; none if it is unknown."""
    sweeps = [each for each in contents if "alias" not in contents[each]]
    if name in OTHERS:
        return [each for each in sweeps if each.startswith(OTHERS[name])]
    if name == ALL or name in CHAPTERS:
        apart = STUDY, *OTHERS.values()
        of_thesis = [each for each in sweeps if not each.startswith(apart) and "claims" in contents[each]]
        return [each for each in of_thesis if each.partition("-")[2].startswith(CHAPTERS.get(name, ""))]
    name = str(contents.get(name, {}).get("alias", name))
    if name in sweeps:
        return [name]
    return [each for each in sweeps if _is_part_of(each, name) or name in _figures(each, contents)]


def _figures(sweep: str, contents: dict[str, dict[str, Any]]) -> set[str]:
    """The figures and tables whose claims a sweep of the thesis tests; none for a study."""
    claims = contents[sweep].get("claims")
    if not sweep.startswith(("fig-", "table-")) or not isinstance(claims, list):
        return set()
    sources = [str(claim.get("source")) for claim in claims if isinstance(claim, dict)]
    found = [match for source in sources for match in _CITED.findall(source)]
    return {f"{'fig' if kind == 'Fig.' else 'table'}-{number}" for kind, number in found}


def _contents() -> dict[str, dict[str, Any]]:
    """The content of all sweeps and aliases by name."""
    return {name: _content(path) for name, path in available("sweeps").items()}


def _content(path: Path) -> dict[str, Any]:
    try:
        return read_mapping(path, display(path))
    except ConfigError:
        return {"claims": []}  # the sweep is not left out: starting it reports the error


def _is_part_of(name: str, figure: str) -> bool:
    """Whether a sweep reproduces a part of a figure or table: `fig-5.5-mountain-car` or `fig-5.2a`."""
    rest = name.removeprefix(figure)
    return rest != name and figure[-1:].isdigit() and not rest[0].isdigit() and rest[0] != "."
