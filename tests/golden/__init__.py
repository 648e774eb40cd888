"""Golden results: what the package computed when its reference files were last written (``make golden``)."""
