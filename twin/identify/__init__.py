"""Identify a machine from its own traces, and plan the traces that identify it.

    campaign_fit    identify_campaign: campaign -> Identification: parameters with intervals, findings, machine (result)
    write           write_identified: the identified machine as a machine file, each value with grade, interval and campaign
    report          write_report: HTML and PNG
    plan            plan_campaign: moves that identify every parameter to a wanted precision, with the predicted interval of each

The direct route, block by block:
    recording           flags checked, late channels taken back            findings           what is wrong with a recording, or missing
    axis_run            one axis in one run, on the position cycles        position_control   gain, feedforward weight, delays
    between_samples     the mean current that samples miss                 speed_control      gain, integral time, torque weight
    drive_balance       inertia, friction, gravity of a linear axis        tilting_pair       the same of A and C together
    least_squares       regression with intervals by strokes               products           what fixes the torque constants
    parameters          the table of all that was found                    noise              measuring noise from standstill
    drive_position_loop position loop in the NC or in the drive    held_out           what no fit sees, and the gap there
The second route: refine (drives with a current loop), drive_fit (lumped drives, every sample). choice: which numbers the file gets.
 single_axis: an axis under another control (EMPS benchmark).
"""
