"""A cut in the viewer: the machine, the tool at the part with path and surface, and the magnified surface of each level.

    +-----------+-------------------------------------------------+
    | machine   | programmed | commanded | followed ...    (tabs) |
    |           | at the part: machine, path,  | relief, the      |
    +-----------+ surface                      | surface magnified|
    | numbers   +-------------------------------------------------+
    |           | colours of the deviation [um]                   |
    +-----------+-------------------------------------------------+

All levels have the same scale and magnification, so that switching between them shows which level made a mark.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh

from twin.machine.machine import Machine
from twin.replay.blueprint import PATH_FROM, around_the_part, enlarged, scene_view, whole_window
from twin.replay.legends import colour_bar_view, log_colour_bar
from twin.replay.names import SUMMARY, entity
from twin.replay.recording import log_machine, log_text, recording_to
from twin.replay.scene import Scene, scene_bounds, scene_of
from twin.replay.toolpaths import followed_joints, log_tool_point, log_whole_path
from twin.report.colours import PROGRAM_COLOUR, SETPOINT_COLOUR, axis_colour
from twin.surface.export import deviation_colours, thinned, triangles
from twin.surface.height_rays import HeightRays
from twin.surface.levels import COMMANDED, PROGRAMMED
from twin.surface.machining import CutSurface, Machining
from twin.surface.picture import colour_end
from twin.units import round_down

MESH_VERTICES = 60_000
"""Most vertices of a surface in the viewer; denser ones are thinned."""
RELIEF_SHARE = 0.08
"""Height of the end of the colour scale in the relief, relative to the surface's size."""
MOST_POSES = 3000
PATH_WIDTH = 0.6
"""Line width [points]; thin, so that the surface between passes stays visible."""
NEAR = 1.8
"""Size of the view at the part, relative to the surface."""
LEAST_SIZE = 0.1
"""Smaller surfaces are enlarged to this size in their view [m]; the viewer draws nothing within 10 mm of the eye."""
LEAN = np.array([0.25, -0.6, 0.0])
"""Offset of the eye from the normal of a level surface: to the front and the right."""
LEAN_UP = np.array([0.0, 0.0, 0.5])
"""Offset of the eye from the normal of an upright wall: upwards."""


class _Shown(NamedTuple):
    """One surface cut by one level: the cut, entities of its surface, its relief magnified by `factor`, and its path."""

    cut: CutSurface
    factor: float
    surface: str
    relief: str
    path: str


def write_cut(path: Path, machine: Machine, machining: Machining) -> None:
    """Write the recording of a cut; the machine moves along its last followed path."""
    part = machining.part
    # the spindle holds the tool of the part file
    length = part.tool.length
    if "tool_length_m" in machine.document.get("geometry", {}):
        machine = machine.with_values({"geometry.tool_length_m": length})
    scene = scene_of(machine)
    with recording_to(path, f"{part.name}: {part.tool.name}") as recording:
        level = next((one.level for one in reversed(machining.cuts) if one.level.trace is not None), machining.cuts[-1].level)
        moved = (level.trace.time, followed_joints(level.trace)) if level.trace is not None else (level.path.time[:1], {})
        log_machine(recording, scene, *moved, most=MOST_POSES)
        log_tool_point(recording, entity(scene.part_path, "tool_point"), level.path.time, level.path.tip)
        end = max(colour_end(one.finest.height * 1e6) for one in machining.cuts) * 1e-6
        bands, numbers = deviation_colours(np.linspace(-end, end, 64), end)[:, :3], (np.linspace(-end, end, 5) * 1e6).tolist()
        log_colour_bar(recording, bands, numbers, "deviation from the nominal surface")
        shown = [_log_cut(recording, scene.part_path, one, end) for one in machining.cuts]
        log_text(recording, _numbers(machining, end))
        recording.send_blueprint(_layout(scene, shown))


def _log_cut(recording: rr.RecordingStream, part_frame: str, one: CutSurface, end: float) -> _Shown:
    """Log the surface of a cut, true to scale and with a round magnification (1, 2 or 5 times a power of ten), and its path."""
    name, label = one.surface.name, one.level.label
    size = float(np.linalg.norm(np.ptp(one.finest.point, axis=0)))
    surface, relief = (entity(part_frame, what, name, label) for what in ("surface", "relief"))
    shown = _Shown(one, round_down(max(RELIEF_SHARE * size / end, 1.0)), surface, relief, entity(part_frame, "cut_path", label))
    _log_surface(recording, shown.surface, one.whole, end, 1.0)
    _log_surface(recording, shown.relief, one.finest, end, shown.factor)
    middle, scale = _enlarged(one.finest)
    recording.log(shown.relief, rr.Transform3D(translation=(1.0 - scale) * middle, scale=scale), static=True)
    colour = {PROGRAMMED: PROGRAM_COLOUR, COMMANDED: SETPOINT_COLOUR}.get(one.level.level, axis_colour("Z"))
    tool_path = one.level.path
    log_whole_path(recording, shown.path, tool_path.tip, colour, PATH_WIDTH, float(tool_path.time[-1] - tool_path.time[0]), full=False)
    return shown


def _log_surface(recording: rr.RecordingStream, path: str, rays: HeightRays, end: float, factor: float) -> None:
    """Log a surface as a mesh coloured by its deviation, magnified by `factor` along the rays."""
    rays = thinned(rays, MESH_VERTICES)
    vertices, faces = rays.point + factor * rays.height[:, None] * rays.direction, triangles(rays)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    points, corners, normals = vertices.astype(np.float32), faces.astype(np.uint32), normals.astype(np.float32)
    colours = deviation_colours(rays.height, end)
    mesh = rr.Mesh3D(vertex_positions=points, triangle_indices=corners, vertex_colors=colours, vertex_normals=normals)
    recording.log(path, mesh, rr.AnyValues(quantity="deviation", unit="um", scale_end_um=end * 1e6, magnified=factor), static=True)


def _enlarged(rays: HeightRays) -> tuple[np.ndarray, float]:
    """Centre (3,) [m] of a surface, and the scale that enlarges it to LEAST_SIZE (at least 1)."""
    low, high = rays.point.min(axis=0), rays.point.max(axis=0)
    return 0.5 * (low + high), max(1.0, LEAST_SIZE / float(np.linalg.norm(high - low)))


def _layout(scene: Scene, shown: Sequence[_Shown]) -> rrb.Blueprint:
    root, part_frame = scene.body_paths[0], scene.part_path
    worst = max(range(len(shown)), key=lambda i: float(np.abs(shown[i].cut.finest.height).max()))
    hidden = [f"- {entity(part_frame, word)}/**" for word in ("surface", "relief", "cut_path")]

    def here(one: _Shown) -> list[str]:
        """Contents of a view of the machine with one cut; later entries take precedence."""
        return [*hidden, f"+ {one.surface}", f"+ {one.path}"]

    tabs = []
    for one in shown:
        cut = one.cut
        box, zone = (np.array([rays.point.min(axis=0), rays.point.max(axis=0)]) for rays in (cut.whole, cut.finest))
        centre, scale = _enlarged(cut.finest)
        # the magnified surface is seen along its rays, at a slant: from aside a flat one would be a line
        normal = cut.finest.direction.mean(axis=0)
        level = abs(float(normal[2])) / float(np.linalg.norm(normal))
        above = normal + level * LEAN + (1.0 - level) * LEAN_UP
        inside, title = [*around_the_part(scene), *here(one)], f"Surface, deviation x{one.factor:g}"
        at_part = scene_view("At the part: machine, path, surface", part_frame, inside, enlarged(box, NEAR), seen_from=PATH_FROM)
        relief = scene_view(title, part_frame, [f"+ {one.relief}"], centre + scale * (zone - centre), distance=1.1, seen_from=above)
        tabs.append(rrb.Horizontal(at_part, relief, name=f"{cut.surface.name}: {cut.level.label}"))
    whole = scene_view("Machine", root, [f"+ {root}/**", *here(shown[worst])], np.array(scene_bounds(scene)), floor=True)
    left = rrb.Vertical(whole, rrb.TextDocumentView(origin=SUMMARY, name="Numbers"), row_shares=[1.0, 1.0])
    bar = colour_bar_view("Deviation from the nominal surface [um]: below 0 too deep, above 0 left")
    right = rrb.Vertical(rrb.Tabs(*tabs, active_tab=worst, name="Levels"), bar, row_shares=[6.0, 1.0])
    return whole_window(rrb.Horizontal(left, right, column_shares=[1.0, 2.6]))


def _numbers(machining: Machining, end: float) -> str:
    """Deviations of every cut as a table in markdown."""
    rows = []
    for one in machining.cuts:
        height = one.finest.height * 1e6
        sizes = f"{height.min():.2f} | {height.max():.2f} | {np.sqrt(np.mean(height**2)):.2f}"
        rows.append(f"| {one.surface.name} | {one.level.label} | {sizes} |")
    said = (
        f"Colours end at {end * 1e6:g} um. The surface on the right is magnified along its normals, as its title says. "
        "The tabs switch between the levels: what appears with *commanded* is the interpolator's, what appears with *followed* the drives'."
    )
    head = [f"# {machining.part.name}", machining.part.tool.name, "", "| surface | path | deepest, um | highest, um | RMS, um |"]
    return "\n".join([*head, "|---|---|---:|---:|---:|", *rows, "", said, *(f"\n{note}" for note in machining.part.notes)])
