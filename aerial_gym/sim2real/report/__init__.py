"""Results of a run: pages, tables, figures, randomisation ranges and the output folder."""
