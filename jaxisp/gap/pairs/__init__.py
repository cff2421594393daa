"""The pairs of a data set: read, aligned, with what their headers state."""
