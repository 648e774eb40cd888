"""Readers of flight files: CSV in any mapped layout, and PX4 ULog."""
