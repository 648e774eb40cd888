"""Files of flights as arrays: CSV in any layout that a mapping describes, and ULog."""
