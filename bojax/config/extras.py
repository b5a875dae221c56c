"""The message for an optional package that is not installed, with the command that installs it."""


def how_to_install(extra: str) -> str:
    """The command that installs an extra; the name bojax on the package index is another project's."""
    return f"in the clone of bojax: pip install -e '.[{extra}]'"


class MissingExtra(ImportError):
    """An optional package that is not installed.

    Attributes:
        exit_code: What the command line exits with.
    """

    exit_code = 2

    def __init__(self, package: str, extra: str):
        super().__init__(f"{package} is not installed; {how_to_install(extra)}")
