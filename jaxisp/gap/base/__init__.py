"""The simulator before any effect is added: fitted, or given."""
