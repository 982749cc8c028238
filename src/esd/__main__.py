"""`python -m esd`."""

from esd.cli import main

if __name__ == "__main__":
    main()
