"""The score of the diagnosis: cases whose effects are known, their signs, and the fit."""
