"""`twin replay`: find the recording of a path, or write one from its trace, and show it."""

from collections.abc import Sequence
from pathlib import Path
import sys
import tempfile

from twin.cli.arguments import MACHINE, Args, arg, flag, machine_of
from twin.errors import InputError
from twin.machine.machine import load_machine
from twin.progress import Progress
from twin.recordings.trace import Trace, read_trace
from twin.replay.source import MODEL_ENDINGS, effects_beside, machine_file_in, source_of

ARGUMENTS = (
    arg("paths", "PATH", "output folder, recording (.rrd), trace, or model (.xml .urdf) with an optional trace; two runs are overlaid", nargs="+"),
    MACHINE,
    arg("--screenshot", "FILE.png", "write a picture of the view; needs no display"),
    arg("--at", "SECONDS", "time of the picture (default: the end)", type=float),
    arg("--size", "WIDTHxHEIGHT", "size of the picture in pixels (default: 1920x1080)", default="1920x1080"),
    flag("--serve", "serve the view to browsers on this computer (127.0.0.1), until Ctrl-C"),
    arg("--port", "N", "port of --serve (default: 9090)", type=int, default=9090),
    arg("--out", "FILE.rrd", "write the recording of a trace or a model to this file; do not open the viewer"),
    flag("--full", "keep every sample (about 80 MB a minute), not only the extremes of each stretch"),
)  # fmt: skip


def carry_out(args: Args) -> None:
    """Show the paths; InputError for input that cannot be shown."""
    from twin.replay import viewer

    if args.at is not None and not args.screenshot:
        raise InputError("--at needs --screenshot FILE.png")
    if args.screenshot and Path(args.screenshot).suffix.lower() != ".png":
        raise InputError(f"{args.screenshot}: a screenshot ends in .png; rename it")
    size = _size(args.size)
    if len(args.paths) > 2:
        raise InputError(f"{len(args.paths)} paths given; replay shows one run, or overlays two")
    keep = Path(args.out) if args.out else None
    if keep is not None and keep.suffix.lower() != ".rrd":
        raise InputError(f"{keep}: a recording is written as .rrd; give the file this ending")
    with tempfile.TemporaryDirectory(prefix="twin-replay-", ignore_cleanup_errors=True) as folder:
        shown = recordings_for(args, keep or Path(folder) / "replay.rrd")
        if args.screenshot:
            with Progress("drawing", total=0):
                picture = viewer.screenshot(shown, args.screenshot, args.at, size)
            print(picture)
        elif args.serve:
            viewer.serve(shown, args.port)
        elif keep is not None:
            print(f"written: {', '.join(map(str, shown))}")
        else:
            # the viewer reads the file after this command ends, so a new one must leave the temporary folder
            if (path := shown[0]).parent == Path(folder):
                shown = [path.rename(Path(tempfile.mkdtemp(prefix="twin-replay-")) / path.name)]
            viewer.open_viewer(shown)


def recordings_for(args: Args, out: Path) -> list[Path]:
    """The recordings to show; a new one is written to `out`."""
    from twin.compare.align import on_clock_of
    from twin.replay.recording import write_motion, write_recording

    first = Path(args.paths[0])
    first = machine_file_in(first) or first
    if first.suffix.lower() in (*MODEL_ENDINGS, ".toml"):
        from twin.replay import motion
        from twin.replay.scene import read_scene, scene_of

        if args.machine:
            raise InputError(f"{first}: a model needs no machine file; leave out --machine, or give --machine with the trace alone")
        scene = scene_of(load_machine(first)) if first.suffix.lower() == ".toml" else read_scene(first)
        time, joints = motion.motion_from_trace(scene, Path(args.paths[1])) if len(args.paths) > 1 else motion.sweep(scene)
        text = "" if len(args.paths) > 1 else "No trace was given: each joint sweeps through its range in turn."
        write_motion(out, scene, time, motion.with_mimics(scene, joints), summary=text, full=args.full)
        return [out]
    sources = [source_of(Path(path)) for path in args.paths]
    recordings = [source.recording for source in sources if source.recording]
    lacking = next((source for source in sources if source.trace is None), None)
    as_they_are = len(recordings) == len(sources) and not (args.full or args.machine or args.out)
    notes = [source.note for source in sources if source.note]
    if as_they_are and (len(sources) == 1 or lacking is not None):
        if len(sources) > 1:
            notes = ["the recordings have no trace; they are shown separately, not overlaid"]
        _say(notes)
        return recordings
    if lacking is not None:
        raise InputError(
            f"{lacking.path}: a recording cannot be made again or overlaid without its trace; give the run folder or the trace"
        )
    machine = machine_of(args)
    runs: dict[str, Trace] = {}
    effects: list[str] = []
    for source in sources:
        label = source.label if source.label not in runs else f"{source.label} (2)"
        assert source.trace is not None  # checked above
        trace, shift = read_trace(source.trace, axes=machine.kinds), 0.0
        if runs:
            trace, shift = on_clock_of(next(iter(runs.values())), trace)
        runs[label] = trace
        if shift:
            notes.append(f"{label} is shifted by {shift * 1e3:.4g} ms onto the set points of {next(iter(runs))}")
        if found := effects_beside(source.trace):
            effects.append(f"{label}: effects {found}")
    _say(notes)
    with Progress("writing the recording", total=0):
        write_recording(out, machine, runs, summary="\n".join([*effects, *notes]), full=args.full)
    return [out]


def _say(notes: Sequence[str]) -> None:
    print("".join(f"note: {note}\n" for note in notes), end="", file=sys.stderr)


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if not (320 <= width <= 8192 and 240 <= height <= 8192):
        raise InputError(f"--size {text}: give width and height in pixels between 320x240 and 8192x8192, such as 1920x1080")
    return width, height
