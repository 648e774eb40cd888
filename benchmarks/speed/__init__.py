"""What a start, a layout in memory, an option costs."""
