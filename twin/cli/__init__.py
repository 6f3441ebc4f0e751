"""The command line: `parser` reads the arguments, one module per command carries it out."""

from twin.cli.parser import main

__all__ = ["main"]
