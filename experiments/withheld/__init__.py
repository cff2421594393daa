"""Cameras that share nothing with the package under test: the "real" side of the withheld-effect study.

Written with NumPy, SciPy, OpenCV and Pillow alone, so that a simulator cannot be right about them by sharing
their code. `shoot.write` makes a data set, `study` runs the diagnosis over many, `tables` sums them up.
"""
