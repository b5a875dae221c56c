"""The command line `bojax`, as `python -m bojax`."""

from bojax.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
