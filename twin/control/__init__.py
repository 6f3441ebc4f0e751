"""Blocks of an axis' control, one file each: numbers and keys, compiled update, law over recorded signals.

block              what a block is, how a machine file lists it, and BLOCKS
friction_pulse     pulse on the speed set point at a reversal       set_point_filters  lag and moving average of the set points
command_law        the law of a control whose command is recorded   evidence           held-out evidence between two laws
number             bounds and unit of a number                      library            imports all block files

How a block is added: write a file here that declares its numbers (name for the law, key on a linear and on a rotary axis with the unit at
the end, bounds, machine data of controls) and calls `register(Block(...))`, and name the file in `library`. Nothing else is touched: the
machine file takes `[axis.N.block.NAME]`, checks its keys and bounds and writes it again; `Machine.with_values` reaches each number as
`axis.X.block.NAME.KEY` and the whole list as `axis.X.block`; the data sheet shows it; a simulation calls it. It has one of two forms:

    law     a term of the compiled loop (`twin.simulation.loop_terms`) with its own state. At SETPOINT it changes X_SETPOINT, the delayed set
            point; subtracting c(x) there equals adding c(x) to the actual position, and the feedforward does not see it (tables, backlash).
            At SPEED it changes X_SPEED_SETPOINT, the output of the position controller [axis units/s]; X_SETPOINT and X_FOLLOWING_ERROR are
            its inputs. At DRIVE the speed set point that the drive uses, at CURRENT the current set point. The ideal encoder readings X_SCALE
            and X_MOTOR_POSITION are there at every stage. `constants` gives its parameters, up to PARAMETER_COUNT numbers.
    kernel  weights over the last position cycles of all set points, before position controller and feedforward.

`recorded` evaluates the same law over recorded signals, for diagnosis and identification. A user's Python file after `--effects` may register
its own blocks in the same way.
"""
