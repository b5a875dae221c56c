"""The command line `bojax COMMAND`. Heavy packages are imported after the input has been validated."""
