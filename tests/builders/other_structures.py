"""Machines whose axes are no 840D servo drives: one axis of each structure, files to be changed by tests."""

from __future__ import annotations

from pathlib import Path

from twin.machine.machine import Machine, load_machine

MJCF = """<mujoco model="slides">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>
  <option integrator="Euler" solver="PGS" tolerance="1e-12"/>
  <default>
    <joint solreffriction="0.0005 1" solimpfriction="0.9999 0.9999 0.001"/>
  </default>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="90" diaginertia="1 1 1"/>
      <joint name="X" type="slide" axis="1 0 0"/>
    </body>
    <body name="column">
      <inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>
      <joint name="Z" type="slide" axis="0 0 1"/>
    </body>
    <body name="arm">
      <inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.2"/>
      <joint name="B" type="hinge" axis="0 0 1"/>
    </body>
  </worldbody>
</mujoco>
"""

X_ON_A_VOLTAGE = """[axis.X]
kind = "linear"
structure = "P/P"
drive = "direct"
encoder = "motor"
travel_m = [-0.3, 0.3]
max_velocity_m_per_min = 30.0
max_acceleration_m_per_s2 = 5.0
max_jerk_m_per_s3 = 100.0
moving_mass_kg = 95.0
coulomb_friction_n = 20.0
viscous_friction_n_s_per_m = 200.0
[axis.X.actuator]
command = "voltage"
force_constant_n_per_v = 35.0
peak_voltage_v = 10.0
[axis.X.loops]
position_gain_per_s = 160.0
speed_gain_v_s_per_m = 243.0
speed_mean_cycles = 2
"""
Z_ON_A_CURRENT = """[axis.Z]
kind = "linear"
structure = "P/PI"
travel_m = [-0.2, 0.2]
max_velocity_m_per_min = 20.0
max_acceleration_m_per_s2 = 3.0
max_jerk_m_per_s3 = 60.0
screw_lead_m_per_rev = 0.005
moving_mass_kg = 20.0
rotor_and_screw_inertia_kg_m2 = 1.0e-4
coulomb_friction_nm = 0.05
viscous_friction_nm_s_per_rad = 0.0004
[axis.Z.actuator]
command = "current"
torque_constant_nm_per_a = 0.5
peak_current_a = 12.0
[axis.Z.loops]
position_gain_per_s = 40.0
speed_gain_nm_s_per_rad = 0.05
speed_integral_time_s = 0.02
speed_filter_time_s = 0.0015
velocity_feedforward = 1.0
position_delay_s = 0.001
"""
B_ON_A_TORQUE = """[axis.B]
kind = "rotary"
structure = "P/P"
travel_deg = [-170.0, 170.0]
max_velocity_rev_per_min = 30.0
max_acceleration_rev_per_s2 = 1.0
max_jerk_rev_per_s3 = 20.0
gear_ratio = 50.0
rotor_and_gear_inertia_kg_m2 = 1.0e-4
coulomb_friction_nm = 0.02
viscous_friction_nm_s_per_rad = 0.0002
[axis.B.actuator]
command = "torque"
peak_torque_nm = 3.0
[axis.B.loops]
position_gain_per_s = 30.0
speed_gain_nm_s_per_rad = 0.04
speed_mean_cycles = 1
speed_filter_time_s = 0.002
velocity_feedforward = 0.5
"""
AXES = {"X": X_ON_A_VOLTAGE, "Z": Z_ON_A_CURRENT, "B": B_ON_A_TORQUE}


def machine_text(axes: str = "XZB", cycles_us: tuple[int, int] = (500, 1000)) -> str:
    """A machine file with these axes, and its speed and position cycle."""
    head = f'name = "slides"\nmodel = "slides.xml"\ngravity_m_per_s2 = 9.81\nparameter_tolerance = 0.01\naxis_order = {list(axes)}\n'
    control = f"[control]\nspeed_cycle_us = {cycles_us[0]}\nposition_cycle_us = {cycles_us[1]}\n"
    measurement = "[measurement]\nsample_period_us = 1000\nmotor_encoder_resolution_m = 5e-8\n"
    return head.replace("'", '"') + control + "".join(AXES[a] for a in axes) + measurement


def write_slides(folder: Path, text: str | None = None) -> Path:
    """Model and machine file in a folder; returns the machine file."""
    (folder / "slides.xml").write_text(MJCF, encoding="utf-8")
    path = folder / "slides.toml"
    path.write_text(machine_text() if text is None else text, encoding="utf-8")
    return path


def slides(folder: Path, axes: str = "XZB", cycles_us: tuple[int, int] = (500, 1000)) -> Machine:
    """The machine with some of its axes."""
    return load_machine(write_slides(folder, machine_text(axes, cycles_us)))
