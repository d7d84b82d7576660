"""Studies: the paper's experiments, and campaigns with thousands of fingers and plates."""
