"""The simulator under diagnosis: effects, model, rendering."""
