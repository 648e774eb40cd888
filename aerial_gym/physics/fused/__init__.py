"""The fused backend: control, rotors, effects and integration of all substeps in one Warp launch."""
