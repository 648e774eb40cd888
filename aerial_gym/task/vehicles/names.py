"""Names of inputs of terms that belong to several vehicles. Letters: V vehicles of an environment, B rows, K neighbours."""

ALL = "all_"  # Prefix of a key or buffer (B, ...): its values for all vehicles of the environment, (B, V, ...)
NEAREST = "nearest_{count}_vehicles"
"""Buffer of the nearest other vehicles, nearest first, (B, 7 K): offset [m], relative velocity [m/s], vehicle frame, and 1;
zeros where there is none."""
