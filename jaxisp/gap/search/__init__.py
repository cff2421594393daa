"""Search for the effects that cause the gap: screening, refits and verdict."""
