"""The base: the simulator before any effect is added, either fitted or given."""
