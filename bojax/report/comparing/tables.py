"""The tables of a comparison: scores, differences from a reference, all tasks together, settings, sources."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from bojax.report import statistics, tables
from bojax.report.comparing.methods import Measure, Method
from bojax.report.comparing.scoring import Task
from bojax.report.ranking import ENDS
from bojax.report.source import Results
from bojax.report.statistics import Floats, Interval
from bojax.report.text import MISSING, counted, line, plain

MOST_NAMED = 8  # runs of a method that are listed by number


def rule(method: Method, measure: Measure) -> str:
    """How runs of different length are compared, in sentences that follow another one."""
    if not (method.has_curve or measure.column in ENDS):
        return ""
    budget = "the largest that all methods have" if measure.options.at is None else "the one of --at"
    stated = f" The budget is {budget}."
    if not method.has_curve:
        return stated
    ended = "has ended" if measure.kind == "planning" else "a success has ended"
    return f"{stated} A run that {ended} keeps its last value, which is then its score."


def remarks(task: Task, measure: Measure) -> str:
    """The budget of a task, and the runs that ended before it or have no value by then, in sentences."""
    first = task.methods[0]
    if not (first.has_curve or measure.column in ENDS):
        return ""
    cut = _listed({each.name: each.cut_off for each in task.methods})
    late = _listed({each.name: each.without_value for each in task.methods})
    budget = f"{measure.unit} {first.at:,.10g}"
    counts = "their last values count" if first.has_curve else "the whole budget counts"
    told = [
        f"The budget of all scores is {budget}.",
        f"Cut off before it, without a success, so that {counts}: {cut}." if cut else "",
        f"Without a value up to it: {late}." if late else "",
    ]
    return " ".join(filter(None, told))


def _listed(runs: Mapping[str, Sequence[int]]) -> str:
    """Runs of methods, the first few by number."""
    phrases = []
    for name, found in runs.items():
        if found:
            more = f" and {counted(len(found) - MOST_NAMED, 'more run')}" if len(found) > MOST_NAMED else ""
            numbers = ", ".join(map(str, found[:MOST_NAMED]))
            phrases.append(f"{'run' if len(found) == 1 else 'runs'} {numbers}{more} of {name}")
    return "; ".join(phrases)


def _budget_cell(method: Method, measure: Measure) -> tables.Cell:
    """The budget at which a method is scored, beside its own."""
    at, own = f"{method.at:,.10g}", method.budget
    if not method.has_curve and measure.column not in ENDS:
        return tables.Cell(f"{own:,.10g}" if np.isfinite(own) else "every run has ended", key=own)
    if own == method.at:
        return tables.Cell(at, key=own)
    return tables.Cell(f"{at} of {own:,.10g}" if np.isfinite(own) else f"{at}; every run has ended", key=own)


def scores(task: Task, measure: Measure) -> tables.Table:
    """One row per method: mean, interquartile mean, and the comparison of several with the reference."""
    rows, reference, is_compared = [], task.reference, len(task.methods) > 1
    has_budgets = any(np.isfinite(each.budget) and each.budget != each.at for each in task.methods)
    has_cuts = any(each.cut_off for each in task.methods)
    for each in task.methods:
        middle = statistics.iqm_interval([each.scores])
        cells = [
            tables.count_cell(each.scores.size),
            tables.interval_cell(each.mean, as_percent=each.is_rate)
            if np.isfinite(each.scores).all()
            else tables.mean_cell(each.scores),
            tables.interval_cell(middle),
        ]
        if each is reference:
            cells += [tables.Cell(MISSING)] * 3 * is_compared
        else:
            cells += [
                tables.interval_cell(difference(each, reference)),
                tables.interval_cell(improvement([(each, reference)], measure), as_percent=True),
                tables.setting_cell("paired" if each.is_paired_with(reference) else "unpaired"),
            ]
        if has_budgets:
            cells.append(_budget_cell(each, measure))
        if has_cuts:
            cells.append(tables.count_cell(len(each.cut_off)))
        rows.append((each.name, cells))
    than = reference.name
    headings = ["runs", "mean", "IQM"]
    headings += [f"difference from {than}", f"P(better than {than})", "runs are"] * is_compared
    headings += [f"budget ({measure.unit}s)"] * has_budgets + ["runs cut off"] * has_cuts
    return tables.Table(headings, rows, remarks(task, measure))


def overall(tasks: Sequence[Task], reference: str, measure: Measure) -> tables.Table | None:
    """One row per name that every one of several tasks has; None if there are fewer than two.

    Scores of a task are scaled so that the worst mean of a method is 0 and the best is 1.
    """
    of_task = [{each.name: each for each in task.methods} for task in tasks]
    shared = [name for name in of_task[0] if all(name in task for task in of_task)]
    if len(tasks) < 2 or len(shared) < 2:
        return None
    scaled = [_scaled([task[name] for name in shared], measure) for task in of_task]
    than = reference if reference in shared else shared[0]
    rows = []
    for place, name in enumerate(shared):
        pairs = [(task[name], task[than]) for task in of_task]
        better = tables.interval_cell(improvement(pairs, measure), as_percent=True)
        middle = statistics.iqm_interval([task[place] for task in scaled])
        rows.append((name, [tables.interval_cell(middle), tables.Cell(MISSING) if name == than else better]))
    return tables.Table(["IQM of scaled scores", f"P(better than {than})"], rows)


def difference(method: Method, reference: Method) -> Interval:
    """Difference of the mean scores: over paired runs, otherwise Welch's; of shares, Newcombe's.

    That of two rates is between -1 and 1. NaN for fewer than two runs or a NaN among the scores.
    """
    first, second = method.scores, reference.scores
    is_known = np.isfinite(first).all() and np.isfinite(second).all()
    if min(first.size, second.size) < 2 or not is_known:
        return Interval()
    is_share = method.is_share and reference.is_share
    if method.is_paired_with(reference):
        both = np.stack([first, second], axis=1)
        found = (
            statistics.paired_shares(both, [1, -1]) if is_share else statistics.mean_interval(first - second)
        )
    elif is_share:
        hits = [(int(scores.sum()), scores.size) for scores in (first, second)]
        found = statistics.share_difference(*hits[0], *hits[1])
    else:
        moments = [(float(each.mean()), float(each.std(ddof=1)), each.size) for each in (first, second)]
        found = statistics.welch_difference(moments[0], moments[1])
    return found.within(-1, 1) if method.is_rate and reference.is_rate else found


def improvement(pairs: Sequence[tuple[Method, Method]], measure: Measure) -> Interval:
    """Probability that a run of the first is better than one of the second, over tasks."""
    strata = [(measure.sign * first.scores, measure.sign * second.scores) for first, second in pairs]
    return statistics.improvement_interval(
        strata, is_paired=all(first.is_paired_with(second) for first, second in pairs)
    )


def settings(methods: Sequence[Method]) -> tables.Table | None:
    """One row per setting that differs among the results folders; None if none does."""
    known = [each for each in methods if each.point.config]
    flat = [dict(tables.flatten(each.point.config)) | {"seed": plain(each.seed)} for each in known]
    keys = dict.fromkeys(key for each in flat for key in each)
    several_tasks = len({each.task for each in methods}) > 1
    names = [f"{each.name}, {each.task}" if several_tasks else each.name for each in known]
    rows = []
    for key in keys:
        values = [each.get(key, MISSING) for each in flat]
        if len(set(values)) > 1:
            rows.append((key, [tables.Cell(value) for value in values]))
    return tables.Table(names, rows) if rows else None


def differing_worlds(tasks: Sequence[Task]) -> list[str]:
    """The settings of the environment or problem that differ among the methods of a task."""
    found = [table for task in tasks if (table := settings(task.methods)) is not None]
    keys = dict.fromkeys(key for table in found for key, _ in table.rows)
    return [key for key in keys if key.startswith(("env.", "problem."))]


def compiled_apart(results: Sequence[Results]) -> str:
    """A sentence that names two results of one sweep whose programs differ; empty without such a pair."""
    for first, second in itertools.combinations(results, 2):
        if first.manifest.differs_in_programs(second.manifest):
            return (
                f" {first.folder} and {second.folder} are the same sweep, compiled with different choices of "
                "kernels: their runs may differ by rounding."
            )
    return ""


def sources(results: Sequence[Results], methods: Sequence[Method]) -> list[tuple[str, str]]:
    """Provenance of each results folder and of other libraries, as path and text."""
    rows = []
    for each in results:
        manifest = each.manifest
        known = {
            "sweep": manifest.name,
            "runs": plain(manifest.runs),
            "seed": plain(manifest.seed),
            "written": manifest.written,
            **manifest.provenance,
            **({"compiled": manifest.compiled} if manifest.programs else {}),
        }
        rows.append((str(each.folder), line(known)))
    folders = {each.folder for each in results}
    for path in dict.fromkeys(each.source for each in methods if each.source not in folders):
        labels = dict.fromkeys(
            f"{each.name} ({each.log_column})" if each.log_column else each.name
            for each in methods
            if each.source == path
        )
        rows.append((str(path), f"curves: {', '.join(labels)}"))
    return rows


def _scaled(methods: Sequence[Method], measure: Measure) -> list[Floats]:
    """Scores with 0 for the worst and 1 for the best mean; NaN if the means are equal."""
    signed = [measure.sign * each.scores for each in methods]
    means = [float(scores.mean()) for scores in signed]
    span = max(means) - min(means)
    return [(scores - min(means)) / (span or np.nan) for scores in signed]
