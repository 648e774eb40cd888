"""Tests of ``aerial_gym.sim2real.predict.round_trip``."""
