"""Sums over blocks of time, Gauss-Newton steps on them, and how sure their results are."""
