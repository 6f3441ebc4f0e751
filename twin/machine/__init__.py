"""A machine as data: the machine file and its model, its axes, keys, checks, loops and data sheet."""

from twin.machine.machine import Machine, load_machine

__all__ = ["Machine", "load_machine"]
