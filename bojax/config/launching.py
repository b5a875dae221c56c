"""Settings of launchers, in the YAML file that `--cluster` names."""

from pathlib import Path
from typing import Annotated, TypeVar

import pydantic
from pydantic import Field

from bojax.config.component import Schema
from bojax.config.errors import control_character, dotted, from_validation
from bojax.config.files import display
from bojax.config.yaml_file import read_mapping


def _on_one_line(text: str) -> str:
    if control_character(text, allows_breaks=False):
        raise ValueError("allowed: text on one line")
    return text


_Word = Annotated[str, Field(min_length=1), pydantic.AfterValidator(_on_one_line)]
"""A word of a line of the batch script."""


class SlurmConfig(Schema, frozen=True):
    """Settings of `--launcher slurm`."""

    tasks: int = Field(default=1, ge=1, description="number of tasks of the array, each a worker")
    partition: _Word | None = Field(default=None, description="partition; null for Slurm's default")
    account: _Word | None = Field(
        default=None, description="account that is charged; null for the user's default"
    )
    time: _Word | None = Field(
        default=None, description="time limit of a task, as D-HH:MM:SS; null for the default"
    )
    gpus_per_task: int = Field(default=0, ge=0, description="number of GPUs of a task")
    cpus_per_task: int | None = Field(default=None, ge=1, description="number of cores of a task")
    memory: _Word | None = Field(default=None, description="memory of a task, such as 32G")
    options: tuple[_Word, ...] = Field(
        default=(), strict=False, description="further options of sbatch, such as --constraint=h100"
    )
    setup: tuple[_Word, ...] = Field(
        default=(), strict=False, description="lines of shell before the worker, such as module load cuda"
    )


class RayConfig(Schema, frozen=True):
    """Settings of `--launcher ray`."""

    address: str | None = Field(
        default=None, description="address of a Ray cluster; null for RAY_ADDRESS, or else this machine"
    )
    workers: int | None = Field(
        default=None, ge=1, description="number of workers; null for one for each GPU, or all CPU cores"
    )
    cpus_per_worker: int | None = Field(
        default=None, ge=1, description="workers on CPUs instead of GPUs, each with this number of cores"
    )


Config = TypeVar("Config", bound=Schema)


def load_launching(path: Path | None, kind: type[Config]) -> Config:
    """The settings in a file; the defaults without one."""
    if path is None:
        return kind()
    file = display(path)
    try:
        return kind.model_validate(read_mapping(path, file))
    except pydantic.ValidationError as error:
        raise from_validation(error, lambda location: f"{file}: {dotted(location)}") from error
