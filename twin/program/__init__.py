"""Part programs: reading (Sinumerik and ISO G-code, APT/CL), interpolation to set points, error budget of one program."""

from twin.program.budget import ErrorBudget, error_budget, plot_feed
from twin.program.interpolator import interpolate, set_point_blocks
from twin.program.moves import Moves, Program
from twin.program.read import PROGRAM_ENDINGS, is_program, read_program

__all__ = [
    "PROGRAM_ENDINGS",
    "ErrorBudget",
    "Moves",
    "Program",
    "error_budget",
    "interpolate",
    "is_program",
    "plot_feed",
    "read_program",
    "set_point_blocks",
]
