"""Identify a machine from its own traces, and plan the traces that identify it.

    identify        campaign -> Identification: parameters with intervals, findings, machine (result)
    write           write_identified: the identified machine as a machine file, each value with grade, interval and campaign
    report          write_report: HTML and PNG
    plan            plan_campaign: moves that identify every parameter to a wanted precision, with predicted intervals

The regression (regressions: all blocks of all axes):
    recording           checks flags, corrects late channels               findings           problems of a recording
    axis_run            one axis in one run, on the position cycles        position_control   gain, feedforward weight, delays
    between_samples     mean current of a cycle from its samples           speed_control      gain, integral time, torque weight
    drive_balance       inertia, friction, gravity of a single axis        rotary_pair        the same for two rotary axes together
    torque_constants    splits products with torque constants              parameters         table of the identified parameters
    drive_position_loop position loop in the NC or in the drive            effort_delivered   commanded against delivered effort
    position_law        the law of the position controller                 position_law_search  the search for its numbers
    position_law_variants  lag, cycles between samples beside it           recorded_pid       the parts of a PID in its place
    recorded_pulse      pulses of a friction compensation beside it
What it leaves open: drive_fit, in closed loop on every sample (lumped drives; position controllers whose output is not recorded).
held_out        training and held-out motion, gap on the latter, and the values that the machine file gets
recorded_command  the law of a recorded current and the encoders that close its loops, where no speed set point is recorded
from_recording  a machine without a data sheet, from first_values and this identification
"""
