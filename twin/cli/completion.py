"""`twin completion bash|zsh|tcsh`: print a completion script."""

import argparse

from twin.errors import InputError

HELP = "shell, e.g. twin completion bash > ~/.local/share/bash-completion/completions/twin"
ARGUMENTS = (("shell", {"choices": ("bash", "zsh", "tcsh"), "help": HELP}),)


def carry_out(args: argparse.Namespace) -> None:
    """Print the completion of every command and option."""
    try:
        import shtab
    except ImportError:
        raise InputError("completion needs shtab: pip install 'twin[completion]'") from None
    from twin.cli.parser import build_parser

    parser = build_parser()
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            action.help = "command"  # shtab skips arguments whose help is suppressed
    print(shtab.complete(parser, shell=args.shell))
