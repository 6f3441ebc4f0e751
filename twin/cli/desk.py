"""`twin desk FOLDER`: a local web page of the results in a folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from twin.cli.arguments import add_open
from twin.errors import InputError
from twin.stopping import until_ctrl_c


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of the command."""
    parser.add_argument("folder", metavar="FOLDER", nargs="?", default="out", help="folder with results (default: out)")
    parser.add_argument("--port", type=int, default=0, metavar="N", help="port (default: a free one)")
    add_open(parser, "open the desk in the browser")


def carry_out(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C."""
    from twin.desk.server import Desk

    folder = Path(args.folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a folder with results, such as the --out folder of a command")
    if not 0 <= args.port < 65536:
        raise InputError(f"--port {args.port}: give a number from 1 to 65535")
    with Desk(folder, args.port) as desk, until_ctrl_c():
        print(f"{folder} on {desk.address} until Ctrl-C", flush=True)
        if args.open:
            import webbrowser

            webbrowser.open(desk.address)
        desk.serve_forever()
    return 0
