"""The command line."""

from esd.cli.app import main

__all__ = ["main"]
