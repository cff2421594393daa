"""What the search minimises: pixel errors, or differences of statistics."""
