"""Which effects cause the gap: screening, refits, verdict."""
