"""Detection of failures in flight: rotors or power supply that deviate from a certain time on."""
