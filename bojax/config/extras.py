"""Optional packages: what each is for, and the error if one is missing, with the command that installs it."""

import contextlib
from collections.abc import Iterator
from typing import Self

from bojax.errors import UserError

OPTIONAL = {
    "gym": ("gymnasium", "environments of Gymnasium"),
    "geo": ("rasterio", "GeoTIFF, NetCDF and map projections"),
    "ray": ("ray", "--launcher ray"),
    "tensorboard": ("tensorboardX", "bojax export --to tensorboard, event files in bojax compare"),
    "wandb": ("wandb", "bojax export --to wandb"),
    "mlflow": ("mlflow", "bojax export --to mlflow"),
}
"""By the name of an extra, a module that it installs and what needs it."""


def how_to_install(extra: str) -> str:
    """The command that installs an extra, from a clone."""
    return f"install it in a clone of bojax: pip install -e '.[{extra}]'"


class MissingExtra(UserError, ImportError):
    """An optional package that is not installed."""

    @classmethod
    def of(cls, package: str, extra: str) -> Self:
        """The error about a package of an extra."""
        return cls(f"{package} is not installed; {how_to_install(extra)}")


@contextlib.contextmanager
def needed(package: str, extra: str) -> Iterator[None]:
    """Context of the imports of an optional package; raises `MissingExtra` if it is not installed."""
    try:
        yield
    except ImportError as error:
        raise MissingExtra.of(package, extra) from error
