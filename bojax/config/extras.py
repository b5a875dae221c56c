"""The error for a missing optional package, with the command that installs the package."""


def how_to_install(extra: str) -> str:
    """The command that installs an extra, from a clone: on PyPI the name bojax belongs to another project."""
    return f"install it in a clone of bojax: pip install -e '.[{extra}]'"


class MissingExtra(ImportError):
    """An optional package that is not installed.

    Attributes:
        exit_code: Exit code of the command line.
    """

    exit_code = 2

    def __init__(self, package: str, extra: str):
        super().__init__(f"{package} is not installed; {how_to_install(extra)}")
