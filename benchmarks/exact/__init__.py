"""How exact each stage is against a reference that nobody here wrote, or the paper's equations in NumPy.

A module a family, each with `rows()`. References and pictures are those of the tests, on more cases.
"""
