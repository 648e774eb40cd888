"""Consistency checks of a flight log: units, frames, clocks, kinematics and rotor columns."""
