"""Optional packages: what each is for, and the error if one is missing, with the command that installs it."""

OPTIONAL = {
    "gym": ("gymnasium", "environments of Gymnasium"),
    "geo": ("rasterio", "GeoTIFF, NetCDF, map projections and bojax survey"),
    "ray": ("ray", "--launcher ray"),
    "tensorboard": ("tensorboardX", "bojax export --to tensorboard, event files in bojax compare"),
    "wandb": ("wandb", "bojax export --to wandb"),
    "mlflow": ("mlflow", "bojax export --to mlflow"),
}
"""By the name of an extra, a module that it installs and what needs it."""


def how_to_install(extra: str) -> str:
    """The command that installs an extra, from a clone."""
    return f"install it in a clone of bojax: pip install -e '.[{extra}]'"


class MissingExtra(ImportError):
    """An optional package that is not installed.

    Attributes:
        exit_code: Exit code of the command line.
    """

    exit_code = 2

    def __init__(self, package: str, extra: str):
        super().__init__(f"{package} is not installed; {how_to_install(extra)}")
