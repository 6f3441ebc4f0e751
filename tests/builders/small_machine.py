"""A machine unlike the Mikron: two axes, U horizontal on a screw and B about the vertical, with cycles of its own."""

from __future__ import annotations

from pathlib import Path

MJCF = """<mujoco model="small">
  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>
  <option timestep="0.00025" integrator="Euler" solver="PGS" tolerance="1e-12"/>
  <default>
    <joint solreffriction="0.0005 1" solimpfriction="0.9999 0.9999 0.001"/>
  </default>
  <worldbody>
    <body name="carriage">
      <inertial pos="0 0 0" mass="40" diaginertia="1 1 1"/>
      <joint name="U" type="slide" axis="1 0 0"/>
      <body name="plate">
        <inertial pos="0 0 0" mass="10" diaginertia="0.1 0.1 0.2"/>
        <joint name="B" type="hinge" axis="0 0 1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

MOTOR = """torque_constant_nm_per_a = 0.5
back_emf_v_s_per_rad = 0.3
resistance_ohm = 1.0
inductance_h = 5.0e-3
peak_current_a = 20.0
bus_limit_v = 200.0
"""
LOOPS = """position_gain_per_s = 30.0
speed_gain_nm_s_per_rad = {gain}
speed_integral_time_s = 0.010
current_gain_v_per_a = 6.0
current_integral_time_s = 0.005
velocity_feedforward = 1.0
torque_feedforward = 0.0
position_delay_s = 0.0013
feedforward_delay_s = 0.0003
"""
TOML = f"""name = "small"
model = "small.xml"
gravity_m_per_s2 = 9.81
axis_order = ["B", "U"]

[control]
current_cycle_us = 250
speed_cycle_us = 500
position_cycle_us = 1000

[axis.U]
kind = "linear"
travel_m = [-0.1, 0.1]
max_velocity_m_per_min = 20.0
max_acceleration_m_per_s2 = 5.0
max_jerk_m_per_s3 = 100.0
screw_lead_m_per_rev = 0.005
moving_mass_kg = 60.0
rotor_and_screw_inertia_kg_m2 = 2.0e-4
coulomb_friction_nm = 0.1
viscous_friction_nm_s_per_rad = 0.0005
[axis.U.motor]
{MOTOR}
[axis.U.loops]
{LOOPS.format(gain=0.1)}
[axis.B]
kind = "rotary"
travel_deg = "endless"
max_velocity_rev_per_min = 30.0
max_acceleration_rev_per_s2 = 1.0
max_jerk_rev_per_s3 = 20.0
gear_ratio = 50.0
rotor_and_gear_inertia_kg_m2 = 1.0e-4
coulomb_friction_nm = 0.05
viscous_friction_nm_s_per_rad = 0.0002
[axis.B.motor]
{MOTOR}
[axis.B.loops]
{LOOPS.format(gain=0.05)}
[measurement]
sample_period_us = 1000
"""


def write_small_machine(folder: Path) -> Path:
    """Write model and machine file; returns the machine file."""
    (folder / "small.xml").write_text(MJCF, encoding="utf-8")
    path = folder / "small.toml"
    path.write_text(TOML, encoding="utf-8")
    return path
