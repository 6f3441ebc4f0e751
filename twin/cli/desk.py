"""`twin desk FOLDER`: a local web page of the results in a folder."""

from pathlib import Path

from twin.cli.arguments import Args, arg, flag, port
from twin.errors import InputError
from twin.stopping import until_ctrl_c

ARGUMENTS = (
    arg("folder", "FOLDER", "folder with results (default: out)", nargs="?", default="out"),
    arg("--port", "N", "port (default: a free one)", type=port, default=0),
    flag("--open", "open the desk in the browser"),
)


def carry_out(args: Args) -> None:
    """Serve until Ctrl-C."""
    from twin.desk.server import Desk

    folder = Path(args.folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a folder with results, such as the --out folder of a command")
    with Desk(folder, args.port) as desk, until_ctrl_c():
        print(f"{folder} on {desk.address} until Ctrl-C", flush=True)
        if args.open:
            import webbrowser

            webbrowser.open(desk.address)
        desk.serve_forever()
