"""Engines on vehicles, for tests of exported policies: the Crazyflie's interface, a Cortex-M4 and RLtools."""
