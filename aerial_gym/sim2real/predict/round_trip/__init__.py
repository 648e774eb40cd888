"""Round trips: recorded setpoints flown by the vehicle's own control law in the simulator, from measured states."""
