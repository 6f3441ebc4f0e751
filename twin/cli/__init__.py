"""The command line: `parser` reads it, one file a command carries it out."""

from twin.cli.parser import main

__all__ = ["main"]
