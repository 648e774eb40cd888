"""Benchmarks of vehicles with joints."""
