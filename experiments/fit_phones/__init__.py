"""Fit cameras whose answer is known in one way or another: `python -m experiments.fit_phones`."""
