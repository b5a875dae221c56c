"""`python -m bojax` is the command line `bojax`."""

from bojax.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
