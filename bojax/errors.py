"""The base class of errors that a user can act on, and exit codes."""

INPUT_ERROR, FAILURE = 2, 1
"""Exit codes of a command: its input must be corrected; the machine or an experiment failed."""


class UserError(Exception):
    """A mistake in the input, or a failure of the machine or of an experiment; the message is one line.

    The command line prints the message, without a traceback.

    Attributes:
        exit_code: Exit code of the command.
    """

    def __init__(self, message: str, exit_code: int = INPUT_ERROR):
        super().__init__(message)
        self.exit_code = exit_code
