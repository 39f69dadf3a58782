"""Studies: longer evidence that writes pages of docs/studies; run by `python -m studies.NAME`."""
