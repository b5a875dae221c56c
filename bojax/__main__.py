"""The command line `bojax`, as `python -m bojax`."""

from bojax.cli.main import entry

if __name__ == "__main__":
    entry()
