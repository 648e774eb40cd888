"""Flight logs to flights: readers, mappings, checks, repair, and which rows are flown."""
