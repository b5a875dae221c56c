"""`bojax reproduce --multiverse`: the claims of sweeps under the choices that their paper leaves open."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bojax.cli.parser import UsageError
from bojax.cli.running import run
from bojax.config.errors import say
from bojax.engine.resolve import resolved
from bojax.results.folder import dated_folder, require_empty

if TYPE_CHECKING:
    from bojax.claims.multiverse.declaration import Declaration
    from bojax.claims.multiverse.outcomes import Entry, Multiverse

PAGE = "report.html"


def main(name: str, args: Namespace, words: Sequence[str]) -> int:
    """Run or continue an analysis, and return the exit code."""
    from bojax.claims.multiverse.declaration import declared
    from bojax.claims.multiverse.outcomes import FILE, evaluated, extended, read, write

    declaration = declared(args.multiverse)
    changed = {key: value for key in ("runs", "seed") if (value := getattr(args, key)) is not None}
    declaration = declaration.with_changes(changed)
    out = args.out or _folder(declaration.name, resume=args.resume)
    if not args.resume:
        require_empty(out, "give another --out, or --resume an analysis")
    if not args.out:  # so that the printed command resumes this folder
        words = [*words, "--out", str(out)]
    command = ["bojax", name, *words]
    multiverse = read(out, declaration)
    done = set(multiverse.done)
    left = [number for number in range(len(multiverse.configurations)) if number not in done]
    asked = left if args.configurations is None else left[: args.configurations]
    size = declaration.file.block
    from bojax.engine.program_cache import held

    exit_code = 0
    with held():
        for start in range(0, len(asked), size):
            numbers = asked[start : start + size]
            folder = out / "blocks" / f"{numbers[0]:05d}-{numbers[-1]:05d}"
            say(f"configurations {numbers[0]} to {numbers[-1]} of {len(multiverse.configurations)}")
            code, folders = _run(declaration, numbers, None, None, folder, args, command)
            if folders is None:
                return code
            exit_code |= code
            entries = evaluated(declaration, folders, numbers)
            _warn_of_untested(entries)
            multiverse = extended(multiverse, declaration, entries)
            write(out, multiverse)
        if args.configurations != 0 and multiverse.best is not None and multiverse.confirmed is None:
            code, multiverse = _confirm(declaration, multiverse, out / "confirm", args, command)
            if code not in (0, 1):
                return code
            exit_code |= code
            write(out, multiverse)
    write(out, multiverse)  # also with a new title and reading
    from bojax.claims.multiverse.page import summary_of, write_page

    if multiverse.done:
        say(summary_of(multiverse))
    if missing := len(multiverse.configurations) - len(multiverse.done):
        say(f"{missing} of {len(multiverse.configurations)} configurations are left: --resume --out {out}")
    print(out / FILE)
    print(write_page(multiverse, out / PAGE))
    return exit_code


def _warn_of_untested(entries: "Mapping[int, Sequence[Entry]]") -> None:
    """Say which claims could not be tested in some of these configurations, and why in the first of them."""
    reasons: dict[str, list[str]] = {}
    for configuration in entries.values():
        for claim, _, entry in configuration:
            if entry.test.reason:
                reasons.setdefault(claim.id, []).append(entry.test.reason)
    for name, found in reasons.items():
        say(f"warning: {name} is not tested in {len(found)} of {len(entries)} configurations: {found[0]}")


def _run(
    declaration: "Declaration",
    numbers: Sequence[int],
    runs: int | None,
    seed: int | None,
    folder: Path,
    args: Namespace,
    command: list[str],
) -> tuple[int, Mapping[str, Path] | None]:
    """Run these configurations of all sweeps as one plan; the exit code, and the results of each sweep.

    They are None if the plan did not end. Runs that failed are left out of the results.
    """
    sweeps = [resolved(declaration.sweep(each, numbers, runs, seed)) for each in declaration.file.sweeps]
    folders = {
        source: folder / sweep.name for source, sweep in zip(declaration.file.sweeps, sweeps, strict=True)
    }
    is_begun = any(
        (each / ".work").exists() or (each / "manifest.json").exists() for each in folders.values()
    )
    code = run(sweeps, list(folders.values()), is_begun, command, launching=args, reports=False)
    if code not in (0, 1) or not all((each / "manifest.json").exists() for each in folders.values()):
        return code, None  # also after submitting to Slurm, which does not wait
    return code, folders


def _confirm(
    declaration: "Declaration", multiverse: "Multiverse", folder: Path, args: Namespace, command: list[str]
) -> tuple[int, "Multiverse"]:
    """Run the sweep's own configuration and the best one again, on fresh seeds."""
    from bojax.claims.multiverse.outcomes import Confirmed, confirmed

    assert multiverse.best is not None
    runs, seed = declaration.file.confirm.runs, declaration.file.confirm.seed
    say(f"the best configuration is {multiverse.best}; it and the sweep's own run again on fresh seeds")
    numbers = sorted({0, multiverse.best})
    code, folders = _run(declaration, numbers, runs, seed, folder, args, command)
    if folders is None:
        return code, multiverse
    found = confirmed(declaration, folders, numbers)
    fresh = Confirmed(runs=runs, seed=seed, own=found[0], best=found[multiverse.best])
    return code, multiverse.model_copy(update={"confirmed": fresh})


def _folder(name: str, *, resume: bool) -> Path:
    """A new folder, or the newest one of an analysis."""
    folder = dated_folder(f"multiverse/{name}")
    if not resume:
        return folder
    above = folder.parent
    found = sorted(above.iterdir()) if above.is_dir() else []
    if not found:
        raise UsageError(f"{above}: no analysis to resume; to start one, leave out --resume")
    return found[-1]
