"""vibrid beside other packages: each in its own environment and process, on the same data."""
