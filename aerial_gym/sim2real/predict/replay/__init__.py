"""What has a memory of its own, run along flights: rotors, loads, joints."""
