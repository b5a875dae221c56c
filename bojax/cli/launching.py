"""The options of `bojax sweep`, `bojax reproduce` and `bojax tune` that choose where chunks run."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bojax.cli.parser import Parser, UsageError, integer, path
from bojax.cli.worker import device_indices
from bojax.config.launching import RayConfig, SlurmConfig, load_launching

if TYPE_CHECKING:
    from bojax.engine.remote import Launcher

LAUNCHING_USAGE = "\n             [--launcher inline|ray|slurm] [--cluster FILE] [--devices I,J] [--dry-run]"

INLINE = Namespace(launcher="inline", cluster=None, devices=None, dry_run=False)
"""The options of a command without them: all chunks run in this process, on all devices."""


def add_launching(parser: Parser) -> None:
    """Add the options."""
    launcher = "what runs the chunks: this process, Ray actors or a Slurm array (default: inline)"
    parser.add_argument("--launcher", choices=("inline", "ray", "slurm"), default="inline", help=launcher)
    parser.option("--cluster", "FILE", "YAML file with settings of --launcher ray or slurm", path)
    parser.option("--devices", "I,J", "indices of the GPUs to use (default: all)", device_indices)
    parser.flag("--dry-run", "with --launcher slurm: print the script, submit nothing")


def add_running(parser: Parser, out: str, resume: str) -> None:
    """Add the options of every command that runs sweeps."""
    parser.option("--runs", "N", "number of runs of each point (default: as in the file)", integer)
    parser.option("--seed", "S", "seed of the keys of all runs (default: as in the file)", integer)
    parser.option("--out", "DIR", out, path)
    parser.flag("--resume", resume)
    parser.set_defaults(**vars(INLINE))


def check_launching(args: Namespace) -> None:
    """Refuse options that do not fit each other, and wrong settings.

    Raises:
        UsageError: An option does not fit the launcher.
        ConfigError: A setting in the file is wrong.
    """
    launcher = args.launcher
    if launcher == "inline" and args.cluster:
        raise UsageError("--cluster: allowed: only with --launcher ray or slurm")
    if launcher != "inline" and args.devices is not None:
        raise UsageError("--devices: allowed: only without --launcher; a cluster chooses the devices")
    if launcher != "slurm" and args.dry_run:
        raise UsageError("--dry-run: allowed: only with --launcher slurm")
    if launcher != "inline":
        load_launching(args.cluster, SlurmConfig if launcher == "slurm" else RayConfig)


def launcher_of(args: Namespace, *, waits: bool = False) -> tuple["Launcher | None", list[int] | None]:
    """The launcher, None for this process, and the indices of the devices that this process uses.

    A command that needs the results `waits` for Slurm, too.
    """
    if args.launcher == "slurm":
        from bojax.engine.launchers.slurm import Slurm

        return Slurm(load_launching(args.cluster, SlurmConfig), waits=waits), None
    if args.launcher == "ray":
        from bojax.engine.launchers.ray_actors import Ray

        return Ray(load_launching(args.cluster, RayConfig)), None
    return None, args.devices


def dry_run(args: Namespace, names: Sequence[str], folders: Sequence[Path]) -> int:
    """Print the script that would be submitted to Slurm, with a share for each task.

    The number of shares of a submission also depends on the groups of the sweeps, which are not built here.
    """
    from bojax.engine.launchers.slurm import Slurm

    config = load_launching(args.cluster, SlurmConfig)
    print(Slurm(config).script(", ".join(names), folders, config.tasks), end="")
    return 0
