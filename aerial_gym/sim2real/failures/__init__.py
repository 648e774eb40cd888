"""Failures in flight: a rotor or the supply does something else from a moment on."""
