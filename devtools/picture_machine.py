"""Render a still picture of the machine.

    python devtools/picture_machine.py                                  docs/pictures/machine.png
    python devtools/picture_machine.py --pose 40 -80 -100 20 35 --camera table --output part.png

Renders without a display; set MUJOCO_GL=osmesa if EGL is missing.
"""

import argparse
import math
import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # read once, when mujoco is imported

import mujoco
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "models" / "scene.xml"
AXES = ("X", "Y", "Z", "A", "C")


def picture(pose: dict[str, float], camera: str, width: int, height: int) -> Image.Image:
    """Picture of the machine with each axis of `pose` (m or rad) set; nothing is simulated."""
    model = mujoco.MjModel.from_xml_path(str(SCENE))
    data = mujoco.MjData(model)
    for axis, position in pose.items():
        data.joint(axis).qpos[0] = position
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera=camera)
        return Image.fromarray(renderer.render())


def main() -> None:
    parser = argparse.ArgumentParser(description="Render a still picture of the machine.")
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "pictures" / "machine.png", help="PNG to write")
    parser.add_argument(
        "--pose",
        type=float,
        nargs=5,
        metavar=AXES,
        default=[60.0, -60.0, -60.0, 25.0, 35.0],
        help="X Y Z in mm, A C in degrees",
    )
    parser.add_argument("--camera", default="machine", help="a camera of models/scene.xml: machine, table, front, side")
    parser.add_argument("--size", type=int, nargs=2, metavar=("WIDTH", "HEIGHT"), default=[1600, 1200], help="pixels")
    args = parser.parse_args()

    x, y, z, a, c = args.pose
    pose = dict(zip(AXES, (x / 1e3, y / 1e3, z / 1e3, math.radians(a), math.radians(c)), strict=True))
    args.output.parent.mkdir(parents=True, exist_ok=True)
    picture(pose, args.camera, *args.size).save(args.output)
    print(args.output)


if __name__ == "__main__":
    main()
