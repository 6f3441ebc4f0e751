"""Blocks of an axis' control, one file each: numbers and keys, law, compiled update, linear model.

The structure of an axis (`structure = "P/PI/PI"`) is a list of the first blocks; its machine file lists further ones in `[axis.N.block.NAME]`.

position_controller   P, speed and torque feedforward               friction_pulse     pulse on the speed set point at a reversal
drive_position_loop   position loop closed in the drive             set_point_filters  lag and moving average of the set points
speed_controller      P or PI; measured or differentiated speed     structures         lists of blocks: P/PI/PI, P/PI, P/P
current_controller    PI and winding of a motor                     stepper            field and rotor of a stepper motor, open loop
actuator              a motor, or what stands in for one        speed_set_point_filters  lag of the speed set point or of its record

block, library        what a listed block is, and all of them       command_law        the law of a control whose command is recorded
number                what the declaration of a number says         command_columns    its columns; command_run: its set points
                                                                    linear             sampled linear systems for the margins

Other rooms ask the blocks (`axis.loops`, `axis.actuator`, `axis.blocks`) for an answer; they know no kind of structure and keep no tables of numbers.

How a block is added: write a file here that declares its numbers (name for the law, key on a linear and on a rotary axis with the unit at
the end, bounds, machine data of controls) and calls `register(Block(...))`, and name the file in `library`. Nothing else is touched: the
machine file takes `[axis.N.block.NAME]`, checks its keys and bounds and writes it again; `Machine.with_values` reaches each number as
`axis.X.block.NAME.KEY` and the whole list as `axis.X.block`; the data sheet shows it; a simulation calls it. It has one of two forms:

    law     a term of the compiled loop (`twin.simulation.loop_terms`) with its own state. At SETPOINT it changes X_SETPOINT, the delayed set
            point; subtracting c(x) there equals adding c(x) to the actual position, and the feedforward does not see it (tables, backlash).
            At SPEED it changes X_SPEED_SETPOINT, the output of the position controller [axis units/s]; X_SETPOINT, X_FED_STEP and
            X_FOLLOWING_ERROR are its inputs. At DRIVE the speed set point that the drive uses, at CURRENT the current set point. The ideal
            encoder readings X_SCALE and X_MOTOR_POSITION are there at every stage. `constants` gives its parameters, up to PARAMETER_COUNT numbers.
    kernel  weights over the last position cycles of all set points, before position controller and feedforward.

Numbers that scale what a block does are its `strengths`: each is an effect, so a diagnosis names a block that the control lost or sizes
otherwise, and the remedy says what to enter. A user's Python file after `--effects` may register its own blocks in the same way.
"""
