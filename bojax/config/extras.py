"""What is said where an optional package is not installed."""


class MissingExtra(ImportError):
    """An optional package that is not installed.

    Attributes:
        exit_code: What the command line exits with.
    """

    exit_code = 2

    def __init__(self, package: str, extra: str):
        super().__init__(f'{package} is not installed: pip install "bojax[{extra}]"')
