"""Identify a machine from its own traces, and plan the traces that identify it.

    identify        campaign -> Identification: parameters with intervals, findings, machine (result)
    write           write_identified: the identified machine as a machine file, each value with grade, interval and campaign
    report          write_report: HTML and PNG
    plan            plan_campaign: moves that identify every parameter to a wanted precision, with predicted intervals

The direct route, block by block:
    recording           checks flags, corrects late channels               findings           problems of a recording
    axis_run            one axis in one run, on the position cycles        position_control   gain, feedforward weight, delays
    between_samples     mean current of a cycle from its samples           speed_control      gain, integral time, torque weight
    drive_balance       inertia, friction, gravity of a single axis        tilting_pair       the same for A and C together
    parameters          table of the identified parameters                 products           splits products with torque constants
    drive_position_loop position loop in the NC or in the drive            noise              measuring noise from standstill
    held_out            training and held-out motion, gap on the latter    delivered          commanded against delivered effort
What they leave open: drive_fit, in closed loop on every sample (lumped drives; position controllers whose output is not recorded).
choice: which values the machine file gets. from_recording: a machine without a data sheet, from first_values and this identification.
"""
