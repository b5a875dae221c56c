"""`bojax list`: the names of parts, configs, sweeps, reproductions and extras, and the settings of a part.

It imports no JAX.
"""

import shutil
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path

from bojax.cli.parser import Parser, UsageError
from bojax.config.catalog import kinds, roles
from bojax.config.component import Component
from bojax.config.describe import settings_of, summary_of
from bojax.config.errors import LIST, MAX_NAMES, ConfigError, allowed_names, escaped, printable
from bojax.config.extras import OPTIONAL, how_to_install
from bojax.config.files import available, display
from bojax.config.sweep import load_config
from bojax.config.thesis import groups as reproductions
from bojax.config.yaml_file import read_mapping

_EXAMPLES = """\
  bojax list           all names, with one line each
  bojax list kcbts     the settings of a part, with types, defaults and units
  bojax list planners  the names of one group
  bojax list fig-5.3   the sweeps that bojax reproduce starts by this name
  bojax list extras    what needs which package, and whether it is installed
"""

_FILES = ("configs", "sweeps")

_WIDEST = 36
"""Characters of a column before the last, so that a setting with many words leaves room for its meaning."""

_REPRODUCTIONS, _EXTRAS = "reproductions", "extras"

_PLACES = {
    "acquisition": ("planner.acquisition", "parking"),
    "env": ("env", "mountain-car", "chain"),
    "exploration-reward": ("learner.exploration_reward", "chain"),
    "features": ("learner.features", "mountain-car", "chain learner=rff-q"),
    "field": ("problem.field", "two-pits"),
    "kernel": ("problem.kernel", "two-pits"),
    "leaf-value": ("planner.leaf_value", "vdp-tag", "vdp-tag planner=pft-dpw"),
    "learner": ("learner", "mountain-car", "chain"),
    "mean": ("problem.mean", "two-pits"),
    "motions": ("planner.motions", "parking", "two-pits"),
    "objective": ("planner.objective", "two-pits"),
    "physics": ("env.physics", "hopper"),
    "planner": ("planner", "parking", "two-pits", "vdp-tag"),
    "problem": ("problem", "parking", "two-pits", "vdp-tag"),
    "proposal": ("planner.proposal", "vdp-tag"),
    "schedule": ("schedule", "chain"),
    "sensor": ("problem.sensor", "two-pits"),
    "vehicle": ("problem.vehicle", "parking", "two-pits"),
    "widening": ("planner.action_widening", "vdp-tag"),
}
"""By role, a setting that takes its parts, and configs: the first that accepts a part is its example."""

_OF_KINDS = {
    ("features", "indicators"): "chain learner=rff-q",
    ("leaf-value", "belief-rollout"): "light-dark",
    ("leaf-value", "state-value"): "tiger",
    ("learner", "additive"): "chain",
    ("learner", "epsilon-greedy"): "chain",
    ("learner", "exploration-values"): "chain",
    ("planner", "policy"): "light-dark",
    ("problem", "pomdp-mountain-car"): "vdp-tag planner=pft-dpw",
    ("problem", "uncertain-pose"): "vdp-tag planner=pft-dpw",
    ("sensor", "range"): "hilly-terrain",
    ("vehicle", "wheeled-robot"): "robot-parking",
}
"""The config of parts that do not fit the others of a config above, which no schema says."""

Members = (
    Mapping[str, type[Component]]
    | Mapping[str, Path]
    | Mapping[str, list[str]]
    | Mapping[str, tuple[str, str]]
)
"""What a group has, by name: parts, files whose titles are read once they are shown, several sweeps, or the
module that an extra installs and what needs it."""


def main(name: str, words: Sequence[str]) -> int:
    """Run the command and return its exit code."""
    about = "List parts (problems, planners, ...), configs and sweeps, or the settings of a part."
    parser = Parser(name, "[NAME ...]", about, _EXAMPLES)
    parser.option("names", "NAME", "name of a part, a group, a config or a sweep (default: all)", nargs="*")
    args = parser.read(words)
    groups = _groups()
    if args.names:
        blocks = [block for wanted in args.names for block in _about(wanted, groups)]
    else:
        blocks = [_group(title, members) for title, members in groups.items()]
    print("\n\n".join(blocks))
    if not args.names:
        print("\nbojax list NAME shows the settings of a part.")
    return 0


def _groups() -> dict[str, Members]:
    """Every name with its part or file, by group, without empty groups."""
    groups: dict[str, Members] = {base.plural: kinds(role) for role, base in roles().items()}
    groups |= {folder: available(folder) for folder in _FILES}
    groups[_REPRODUCTIONS] = reproductions()
    groups[_EXTRAS] = OPTIONAL
    return {title: members for title, members in groups.items() if members}


def _title(path: Path) -> str:
    try:
        mapping = read_mapping(path, display(path))
    except ConfigError as error:
        return f"(invalid: {printable(error)})"
    if "alias" in mapping:
        return f"alias of {mapping['alias']}"
    return str(mapping.get("title", ""))


def _about(name: str, groups: Mapping[str, Members]) -> list[str]:
    if name in groups:
        return [_group(name, groups[name])]
    blocks = [_part(role, kinds(role)[name]) for role in roles() if name in kinds(role)]
    for folder in _FILES:
        path = available(folder).get(name)
        if path is not None:
            command = "run" if folder == "configs" else "sweep"
            about = f"{name}: a {folder[:-1]}, {display(path)}\n  {_title(path)}"
            blocks.append(f"{about}\n  bojax {command} {name}")
    sweeps = groups[_REPRODUCTIONS].get(name)
    if isinstance(sweeps, list):
        names = _indented(", ".join(sweeps))
        blocks.append(f"{name}: the sweeps\n{names}\n  bojax reproduce {name}")
    if name in OPTIONAL:
        blocks.append(f"{name}: an extra\n{_indented(_summary(OPTIONAL[name]))}\n  {how_to_install(name)}")
    if not blocks:
        names = {*groups, *(known for members in groups.values() for known in members)}
        raise UsageError(f"unknown name {name}{allowed_names(name, names, LIST)}")
    return blocks


def _part(role: str, schema: type[Component]) -> str:
    what = "a family of trajectories (role motions)" if role == "motions" else f"a {role}"
    what = f"an {role}" if role[0] in "aeiou" else what
    head = f"{schema.model_fields['kind'].default}: {what}\n{_indented(summary_of(schema))}"
    rows = [(each.name, each.type, each.default, each.meaning) for each in settings_of(schema)]
    table = (
        _table([("setting", "type", "default", "meaning"), *rows]) if rows else "  This part has no settings."
    )
    example = _example(role, schema.model_fields["kind"].default)
    return f"{head}\n\n{table}" + (f"\n\n  {example}" if example else "")


def _example(role: str, kind: str) -> str:
    """A command that uses a part; empty if no command can, as of a part that needs a file or an id."""
    if role in ("env", "problem") and kind in available("configs"):
        return f"bojax run {kind}"
    key, *configs = _PLACES.get(role, ("",))
    own = _OF_KINDS.get((role, kind))
    for config, *settings in map(str.split, configs if own is None else [own]):
        words = [*settings, f"{key}={kind}"]
        with suppress(ConfigError):
            load_config(config, words)
            return " ".join(["bojax run", config, *words])
    return ""


def _group(title: str, members: Members) -> str:
    table = _table([(name, _summary(member)) for name, member in members.items()])
    role = next((role for role, base in roles().items() if base.plural == title), "")
    examples = {
        "areas": "bojax survey 500x300 --budget 2km writes a config with one",
        "experiments": "bojax run chain",
        "configs": "bojax run parking",
        "sweeps": "bojax sweep parking; bojax reproduce takes their names too",
        _REPRODUCTIONS: "bojax reproduce fig-5.3",
        _EXTRAS: how_to_install("gym"),
    }
    example = examples.get(title) or next(filter(None, (_example(role, kind) for kind in members)), "")
    return f"{title}\n{table}" + (f"\n  {example}" if example else "")


def _summary(member: type[Component] | Path | list[str] | tuple[str, str]) -> str:
    if isinstance(member, tuple):
        module, purpose = member
        state = "installed" if find_spec(module) else "not installed"
        return f"{purpose}: needs {module}, {state}"
    if isinstance(member, list):
        return ", ".join(member) if len(member) <= MAX_NAMES else f"{len(member)} sweeps"
    return _title(member) if isinstance(member, Path) else summary_of(member)


def _table(rows: Sequence[Sequence[str]]) -> str:
    """A table with aligned columns; the last is wrapped to the width of the terminal, others at `_WIDEST`."""
    rows = [[escaped(cell) for cell in row] for row in rows]
    whole = textwrap.TextWrapper(_WIDEST, break_long_words=False, break_on_hyphens=False)  # a name is copied
    wrapped = [[whole.wrap(cell) or [""] for cell in row[:-1]] for row in rows]
    widths = [max(len(line) for cell in column for line in cell) for column in zip(*wrapped, strict=True)]
    room = max(_width() - 2 - sum(width + 2 for width in widths), 30)
    lines = []
    for cells, (*_, last) in zip(wrapped, rows, strict=True):
        for row in zip_longest(*cells, textwrap.wrap(last, room), fillvalue=""):
            padded = (f"{cell:<{width}}  " for cell, width in zip(row, [*widths, 0], strict=True))
            lines.append(f"  {''.join(padded)}".rstrip())
    return "\n".join(lines)


def _indented(text: str) -> str:
    return textwrap.fill(text, _width(), initial_indent="  ", subsequent_indent="  ")


def _width() -> int:
    return min(shutil.get_terminal_size((110, 24)).columns, 140)
