"""The flight recorder: the last minutes, cycle by cycle and frame by frame, in a file in RAM that outlives the daemon."""
