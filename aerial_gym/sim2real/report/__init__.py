"""What a run leaves behind: pages, tables, plots, ranges, and a folder that appears whole."""
