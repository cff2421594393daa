"""The JPEG codec on arrays: tables, blocks, coding."""
