"""The command line: `bojax COMMAND`. Nothing heavy is imported before the user's input is validated."""
