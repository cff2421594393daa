"""Gain of denoisers by the effects found, and the lowest gap that flexible models reach."""
